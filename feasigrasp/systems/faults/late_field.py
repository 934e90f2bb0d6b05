"""Fault injection: delayed distance fields."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Frozen
from feasigrasp.models.faults.control import PerceptionLate
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output, evaluate


@dataclass(frozen=True, eq=False)
class _Post(Frozen):
    """What is on its way while the fault is there.

    Attributes:
        late: Whether the fault is there.
        arrived: The field that has arrived last.
        sent: Those on their way and when they were sent, oldest first.
    """

    late: bool = False
    arrived: Gpdf | None = None
    sent: tuple[tuple[float, Gpdf | None], ...] = ()


class LateField(LeafSystem):
    """Passes the object's field on, but late while there is a fault.

    .. pydrake_system::

        name: LateField
        input_ports:
        - gpdf
        output_ports:
        - gpdf

    Both are a `Gpdf` or None. What had come before the fault stays known; what is on its way when
    the fault ends has come by then. The delay is rounded up to ``period``.
    """

    def __init__(self, fault: PerceptionLate, *, period: float = 0.05) -> None:
        """A fault that is looked after every ``period`` seconds."""
        super().__init__()
        self._fault = fault
        self._input = declare_input(self, "gpdf")
        self._post = PeriodicState(self, _Post(), period, self._deliver)
        declare_output(self, "gpdf", self._calc, {self._input.ticket(), self._post.ticket()})

    def _deliver(self, context: Context) -> _Post:
        time, gpdf = context.get_time(), evaluate(self._input, context)
        post: _Post = self._post.Eval(context)
        if not self._fault.active(time):
            return _Post()
        if not post.late:
            return _Post(True, gpdf, ((time, gpdf),))
        sent = post.sent if gpdf is post.sent[-1][1] else (*post.sent, (time, gpdf))
        due = [i for i, (at, _) in enumerate(sent) if at <= time - self._fault.delay + 1e-9]
        if not due:
            return replace(post, sent=sent)
        return _Post(True, sent[due[-1]][1], sent[due[-1] :])

    def _calc(self, context: Context) -> Gpdf | None:
        post: _Post = self._post.Eval(context)
        gpdf: Gpdf | None = post.arrived if post.late else evaluate(self._input, context)
        return gpdf
