"""Delays values by a latency."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Frozen
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_input,
    declare_output,
    same_value,
    scalar,
)


@dataclass(frozen=True, eq=False)
class _Post(Frozen):
    """What has arrived last, the others and when they arrive [s], and what was sent last."""

    arrived: Any
    sent: tuple[tuple[float, Any], ...] = ()
    newest: Any = None


class Delay(LeafSystem):
    """Hands on every value of its input ``latency`` seconds after it was made.

    .. pydrake_system::

        name: Delay
        input_ports: [u, stamp]
        output_ports: [y]

    ``u`` and ``y`` are Python objects, or vectors. The input is looked at every ``period`` seconds,
    and what has changed since the last time was made then: values come on time if they are made at
    one of these ticks, and else by less than a period too soon. Without latency the system holds
    what there was at the last tick. ``stamp`` (V1), optional, is from when the latency of the
    present value counts [s], such as the exposure that it was made of; NaN for none.
    """

    def __init__(self, initial: Any, latency: float, period: float) -> None:
        """A delay that hands on ``initial`` until something arrives; a vector if that is one."""
        super().__init__()
        self._latency, self._period = latency, period
        self._post = PeriodicState(self, _Post(initial), period, self._deliver)
        self._stamp = self.DeclareVectorInputPort("stamp", 1)
        if isinstance(initial, np.ndarray):
            self._input = self.DeclareVectorInputPort("u", len(initial))
            declare_output(self, "y", self._arrived, {self._post}, size=len(initial))
        else:
            self._input = declare_input(self, "u")
            declare_output(self, "y", self._arrived, {self._post})

    def _arrived(self, context: Context) -> Any:
        return self._post.Eval(context).arrived

    def _deliver(self, context: Context) -> _Post:
        post, value, time = self._post.Eval(context), self._input.Eval(context), context.get_time()
        sent = post.sent
        if not same_value(value, post.newest):
            made = max(0.0, time - self._period) if self._latency > 0.0 else time
            stamp = scalar(self._stamp, context, made)
            sent = (*sent, ((stamp if np.isfinite(stamp) else made) + self._latency, value))
        due = [each for at, each in sent if at <= time + 1e-9]
        return _Post(due[-1] if due else post.arrived, sent[len(due) :], value)
