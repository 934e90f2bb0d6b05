"""Integrates joint velocity commands into desired states of the arm."""

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.velocity_limits import drive_step_kernel
from feasigrasp.models.quantities import Positive, PositiveShare
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.ports import declare_output, weakly


class VelocityDrive(LeafSystem):
    """Integrates a commanded joint velocity within position, velocity and acceleration limits.

    .. pydrake_system::

        name: VelocityDrive
        input_ports: [velocity, position]
        output_ports: [desired_state, command_faults, desired_velocity]

    ``velocity`` [rad/s] and ``position`` [rad] are V7, ``desired_state`` is V14 (positions, then
    velocities: the differences of the positions over the period) and ``desired_velocity`` its
    second half: the last command, which a controller needs that limits accelerations itself.
    ``command_faults`` is V1: how many commands were not finite, or beyond ten times the
    velocity limits. All are state, so no output depends on an input at once. At initialisation the
    measured position is latched.

    What is sent keeps its limits, of the velocities the share ``speed``, whatever is commanded
    (`drive_step_kernel`); a faulty command is one to stop, as hard as the acceleration limits
    allow.
    """

    #: The desired position waits for the measured one when it is this far ahead of it [rad].
    MAX_LEAD = 0.10

    @checked(ControlError)
    def __init__(self, period: Positive, *, speed: PositiveShare = 1.0, arm: Arm = IIWA_7) -> None:
        """A drive that updates every ``period`` [s], at a share ``speed`` of the velocity limits.

        Raises:
            ControlError: Another period or speed.
        """
        super().__init__()
        self._period, self._speed, self._arm = period, speed, arm
        n = arm.joints
        self._velocity = self.DeclareVectorInputPort("velocity", n)
        self._position = self.DeclareVectorInputPort("position", n)
        state = self.DeclareDiscreteState(2 * n)
        faults = self.DeclareDiscreteState(1)
        self.DeclareStateOutputPort("desired_state", state)
        self.DeclareStateOutputPort("command_faults", faults)
        ticket = {self.discrete_state_ticket(state)}
        declare_output(self, "desired_velocity", lambda context: _kept(context)[n:], ticket, size=n)
        self.DeclareInitializationDiscreteUpdateEvent(weakly(self._initialize))
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, weakly(self._update))
        zero = np.zeros(n)
        self._step(zero, zero, zero, zero)  # compiles its kernel, before the first tick

    def _initialize(self, context: Context, discrete_state) -> None:
        q = self._position.Eval(context)
        discrete_state.get_mutable_vector(0).SetFromVector(np.concatenate([q, np.zeros(len(q))]))

    def _update(self, context: Context, discrete_state) -> None:
        q, v = np.split(_kept(context), 2)
        command, measured = self._velocity.Eval(context), self._position.Eval(context)
        desired, fault = self._step(q, v, command, measured)
        discrete_state.get_mutable_vector(0).SetFromVector(desired)
        faults = context.get_discrete_state(1).value() + fault
        discrete_state.get_mutable_vector(1).SetFromVector(faults)

    def _step(self, q, v, command, measured):
        """The next desired state (2 n,), and whether the command is a fault."""
        n = len(q)
        desired = np.empty(2 * n)
        q_next, v_next = desired[:n], desired[n:]
        bounds = self._period, self.MAX_LEAD, self._speed
        fault = drive_step_kernel(self._arm.chain, q, v, command, measured, bounds, q_next, v_next)
        return desired, fault


def _kept(context: Context) -> Array:
    """The last desired state."""
    return context.get_discrete_state(0).value()
