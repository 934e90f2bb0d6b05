"""Ports, caches and states that hold no value: None where they are read, with any Drake."""

import pickle

import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.systems.ports import (
    Nothing,
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    evaluate,
    optional,
)


class Passing(LeafSystem):
    """Passes an object on through a cache entry and a state; None after a second."""

    def __init__(self, made=None):
        super().__init__()
        self.port = declare_input(self, "u")
        self.cache = declare_cache(self, "cache", self.read, {self.port.ticket()})
        self.state = PeriodicState(self, made, 1.0, lambda context: None)
        declare_output(self, "y", lambda context: evaluate(self.cache, context))
        declare_output(self, "state", self.state.Eval, {self.state.ticket()})

    def read(self, context):
        return optional(self.port, context)


@pytest.mark.parametrize("value", [None, [1.0]])
def test_an_object_comes_out_as_it_went_in(value):
    builder = DiagramBuilder()
    first, second = (builder.AddSystem(Passing(value)) for _ in range(2))
    builder.Connect(first.GetOutputPort("state"), second.GetInputPort("u"))
    simulator = Simulator(builder.Build())
    context = second.GetMyContextFromRoot(simulator.get_context())
    for port in ("y", "state"):
        assert evaluate(second.GetOutputPort(port), context) == value
    assert first.read(first.GetMyContextFromRoot(simulator.get_context())) is None
    simulator.AdvanceTo(1.5)
    assert second.read(context) is None
    copy = second.GetMyContextFromRoot(simulator.get_context().Clone())
    assert evaluate(second.GetOutputPort("y"), copy) is None


def test_nothing_is_false_and_the_same_in_another_process():
    assert not Nothing.NOTHING
    assert pickle.loads(pickle.dumps(Nothing.NOTHING)) is Nothing.NOTHING
