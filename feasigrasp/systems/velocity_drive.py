"""Turns joint velocity commands into the desired states that an iiwa follows."""

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.robot.iiwa import IIWA_7


class VelocityDrive(LeafSystem):
    """Integrates a commanded joint velocity within the velocity and acceleration limits.

    .. pydrake_system::

        name: VelocityDrive
        input_ports:
        - velocity
        - position
        output_ports:
        - desired_state
        - desired_velocity

    ``velocity`` [rad/s] and ``position`` [rad] are V7, ``desired_state`` is V14 (positions, then
    velocities) and ``desired_velocity`` its second half: the last command, which a controller needs
    that limits accelerations itself. Both are state, so no output depends on an input at once.
    At initialisation the measured position is latched. A command that is not finite counts as zero.
    With ``enforce_position_limits`` the desired position never leaves the limits.
    """

    #: The desired position never runs further than this ahead of the measured one [rad].
    MAX_LEAD = 0.10
    #: It keeps this distance from the joint limits [rad], since the arm gives way under load.
    LIMIT_MARGIN = 0.01

    def __init__(self, period: float, *, enforce_position_limits: bool = True) -> None:
        """A drive that updates every ``period`` seconds."""
        super().__init__()
        self._period = period
        self._limits = np.full(IIWA_7.joints, np.inf)
        if enforce_position_limits:
            self._limits = IIWA_7.position_limits - self.LIMIT_MARGIN
        self._velocity = self.DeclareVectorInputPort("velocity", IIWA_7.joints)
        self._position = self.DeclareVectorInputPort("position", IIWA_7.joints)
        state = self.DeclareDiscreteState(2 * IIWA_7.joints)
        self.DeclareStateOutputPort("desired_state", state)
        self.DeclareVectorOutputPort(
            "desired_velocity",
            IIWA_7.joints,
            self._calc_velocity,
            {self.discrete_state_ticket(state)},
        )
        self.DeclareInitializationDiscreteUpdateEvent(self._initialize)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._update)

    def _initialize(self, context: Context, discrete_state) -> None:
        q = self._position.Eval(context)
        discrete_state.get_mutable_vector().SetFromVector(
            np.concatenate([q, np.zeros(IIWA_7.joints)])
        )

    def _calc_velocity(self, context: Context, output) -> None:
        output.SetFromVector(context.get_discrete_state_vector().value()[IIWA_7.joints :])

    def _update(self, context: Context, discrete_state) -> None:
        desired = context.get_discrete_state_vector().value()
        q, v = desired[: IIWA_7.joints], desired[IIWA_7.joints :]
        command = self._velocity.Eval(context)
        if not np.isfinite(command).all():
            command = np.zeros(IIWA_7.joints)
        dv = IIWA_7.acceleration_limits * self._period
        v_next = np.clip(
            np.clip(command, -IIWA_7.velocity_limits, IIWA_7.velocity_limits), v - dv, v + dv
        )
        measured = self._position.Eval(context)
        q_next = np.clip(
            q + self._period * v_next, measured - self.MAX_LEAD, measured + self.MAX_LEAD
        )
        q_next = np.clip(q_next, -self._limits, self._limits)
        discrete_state.get_mutable_vector().SetFromVector(np.concatenate([q_next, v_next]))
