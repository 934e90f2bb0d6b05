"""Rate-limited drive of the fingers."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.systems.ports import declare_output, weakly


class FingerDrive(LeafSystem):
    """Rate-limited command of the opening, as the desired state of the left finger.

    .. pydrake_system::

        name: FingerDrive
        input_ports: [opening]
        output_ports: [desired_state]

    ``opening`` is the distance between the pads [m], V1; ``desired_state`` V2, position [m] and
    velocity [m/s] of the left finger, which moves half of it: the right one mimics it. An opening
    that jumps is followed by `SPEED`: fingers that press with all their force within one step deal
    the arm a jolt, as no motor does.
    """

    #: How fast the opening changes at most [m/s]: a choice, well above the speed at which fingers
    #: close.
    SPEED = 1.0

    def __init__(self, period: float) -> None:
        """A drive with a period [s], best that of the plant."""
        super().__init__()
        self._way = self.SPEED * period
        self._opening = self.DeclareVectorInputPort("opening", 1)
        # Where it was a period ago; at first where it is commanded.
        self.DeclareDiscreteState([np.nan])
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._update))
        declare_output(self, "desired_state", self._calc, size=2)

    def _next(self, context: Context) -> float:
        commanded = float(self._opening.Eval(context)[0])
        before = context.get_discrete_state_vector().value()[0]
        if np.isnan(before):
            return commanded
        return before + float(np.clip(commanded - before, -self._way, self._way))

    def _calc(self, context: Context) -> list[float]:
        return [0.5 * self._next(context), 0.0]

    def _update(self, context: Context, state) -> EventStatus:
        state.set_value([self._next(context)])
        return EventStatus.Succeeded()
