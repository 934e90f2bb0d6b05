"""Detects unexpected contact by the arm's external joint torques."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem

from feasigrasp.models.control.planning.touch import touch_state, touch_step_kernel
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.ports import weakly


class ContactSense(LeafSystem):
    """Detects contact of the arm before the fingers close.

    .. pydrake_system::

        name: ContactSense
        input_ports: [torque_external, phase]
        output_ports: [touch, touches]

    ``torque_external`` is V7 [Nm], ``phase`` a `Phase`. ``touch`` is V7, the torques of the contact
    that the arm should give way to [Nm], zero without one; ``touches`` is how often there was one.
    Fingers that close are meant to touch: then nothing is noticed.
    """

    def __init__(self, period: float, arm: Arm = IIWA_7) -> None:
        """A sense with a period [s], best that of the plant, which has the torques at its steps."""
        super().__init__()
        self._period, self._arm = period, arm
        begin = touch_state(arm.joints)
        self._torque = self.DeclareVectorInputPort("torque_external", arm.joints)
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self.DeclareDiscreteState(begin)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._update))
        state = {self.xd_ticket()}
        self.DeclareVectorOutputPort("touch", arm.joints, weakly(self._calc_touch), state)
        self.DeclareVectorOutputPort("touches", 1, weakly(self._calc_touches), state)
        self._update_state(begin, np.zeros(arm.joints))  # compiles

    def _update_state(self, state, torque):
        after = np.empty(len(state))
        touch_step_kernel(self._arm.chain, state, torque, self._period, after)
        return after

    def _update(self, context: Context, discrete) -> EventStatus:
        state = context.get_discrete_state_vector().value()
        if self._phase.Eval(context)[0] != Phase.APPROACH:
            after = state.copy()
            after[: 2 * self._arm.joints + 1] = 0.0
        else:
            after = self._update_state(state, self._torque.Eval(context))
        discrete.set_value(after)
        return EventStatus.Succeeded()

    def _calc_touch(self, context: Context, output) -> None:
        state = context.get_discrete_state_vector().value()
        output.SetFromVector(state[self._arm.joints : 2 * self._arm.joints])

    def _calc_touches(self, context: Context, output) -> None:
        state = context.get_discrete_state_vector().value()
        output.SetAtIndex(0, state[2 * self._arm.joints + 1])
