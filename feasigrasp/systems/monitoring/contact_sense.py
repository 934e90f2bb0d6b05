"""Detects unexpected contact by the arm's external joint torques."""

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.touch import touch_state, touch_step_kernel
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.ports import declare_output, weakly


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
        state, n = {self.xd_ticket()}, arm.joints
        declare_output(self, "touch", lambda context: _state(context)[n : 2 * n], state, size=n)
        declare_output(self, "touches", lambda context: _state(context)[2 * n + 1], state, size=1)
        self._update_state(begin, np.zeros(arm.joints))  # compiles

    def _update_state(self, state, torque):
        after = np.empty(len(state))
        touch_step_kernel(self._arm.chain, state, torque, self._period, after)
        return after

    def _update(self, context: Context, discrete) -> None:
        state = _state(context)
        if self._phase.Eval(context)[0] != Phase.APPROACH:
            after = state.copy()
            after[: 2 * self._arm.joints + 1] = 0.0
        else:
            after = self._update_state(state, self._torque.Eval(context))
        discrete.set_value(after)


def _state(context: Context) -> Array:
    return context.get_discrete_state_vector().value()
