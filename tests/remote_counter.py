"""A stage that a process of its own can run: it adds up numbers, and does as it is told by them."""

import os
import time
from dataclasses import dataclass

from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from feasigrasp.models.arrays import Frozen
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output

#: A number that ends the process, and one that keeps it busy for `NAP` seconds.
DIE, SLEEP, NAP = -1.0, 1000.0, 1.0
PERIOD = 0.1


@dataclass(frozen=True, eq=False)
class Sentence(Frozen):
    text: str


class Counter(LeafSystem):
    def __init__(self):
        super().__init__()
        self._number = self.DeclareVectorInputPort("number", 1)
        self._word = declare_input(self, "word")
        self._reported = PeriodicState(self, (), PERIOD, self._look)
        ticket = {self._reported.ticket()}
        declare_output(self, "grasps", self._reported.Eval, ticket)
        self.DeclareVectorOutputPort("total", 1, self._calc_total, ticket)

    def _look(self, context):
        number = self._number.Eval(context)[0]
        if number == DIE:
            os._exit(3)
        if number == SLEEP:
            time.sleep(NAP)
        word = self._word.Eval(context) if self._word.HasValue(context) else ""
        word = word.text if isinstance(word, Sentence) else word
        return (*self._reported.Eval(context), (context.get_time(), number, word))

    def _calc_total(self, context, output):
        output.SetAtIndex(0, sum(number for _, number, _ in self._reported.Eval(context)))


def broken():
    raise AssertionError("nothing comes of this")


def fixed(system, context, **inputs):
    for name, value in inputs.items():
        port = system.GetInputPort(name)
        port.FixValue(context, [value] if isinstance(value, float) else Value[object](value))
