"""Detects unexpected contact by the arm's external joint torques."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.control.planning.touch import TOUCH_STATE, TOUCHES, touch_step_kernel
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.ports import weakly


class ContactSense(LeafSystem):
    """Detects contact of the arm before the fingers close.

    .. pydrake_system::

        name: ContactSense
        input_ports:
        - torque_external
        - phase
        output_ports:
        - touch
        - touches

    ``torque_external`` is V7 [Nm], ``phase`` a `Phase`. ``touch`` is V7, the torques of the contact
    that the arm should give way to [Nm], zero without one; ``touches`` is how often there was one.
    Fingers that close are meant to touch: then nothing is noticed.
    """

    def __init__(self, period: float) -> None:
        """A sense with a period [s], best that of the plant, which has the torques at its steps."""
        super().__init__()
        self._period = period
        self._torque = self.DeclareVectorInputPort("torque_external", IIWA_7.joints)
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self.DeclareDiscreteState(TOUCH_STATE)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._update))
        state = {self.xd_ticket()}
        self.DeclareVectorOutputPort("touch", IIWA_7.joints, weakly(self._calc_touch), state)
        self.DeclareVectorOutputPort("touches", 1, weakly(self._calc_touches), state)
        self._update_state(np.zeros(TOUCH_STATE), np.zeros(IIWA_7.joints))  # compiles

    def _update_state(self, state, torque):
        after = np.empty(TOUCH_STATE)
        touch_step_kernel(state, torque, self._period, after)
        return after

    def _update(self, context: Context, discrete) -> EventStatus:
        state = context.get_discrete_state_vector().value()
        if self._phase.Eval(context)[0] != Phase.APPROACH:
            after = state.copy()
            after[:TOUCHES] = 0.0
        else:
            after = self._update_state(state, self._torque.Eval(context))
        discrete.set_value(after)
        return EventStatus.Succeeded()

    def _calc_touch(self, context: Context, output) -> None:
        state = context.get_discrete_state_vector().value()
        output.SetFromVector(state[IIWA_7.joints : 2 * IIWA_7.joints])

    def _calc_touches(self, context: Context, output) -> None:
        output.SetAtIndex(0, context.get_discrete_state_vector().value()[TOUCHES])
