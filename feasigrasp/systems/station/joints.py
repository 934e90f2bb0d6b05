"""Joint sensors of the simulated arm, and the drive of its fingers."""

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.sensors.joint_errors import DrawnJointErrors
from feasigrasp.systems.ports import declare_output, weakly


class JointSensors(LeafSystem):
    """Adds the errors of encoders and torque sensors.

    .. pydrake_system::

        name: JointSensors
        input_ports: [position, torque_external, desired_state]
        output_ports: [position_measured, torque_estimated, true_desired_state]

    ``position`` and ``torque_external``, V7, are the true ones [rad], [Nm]; the first two outputs
    what the arm reports. The arm's own controller goes by the same encoders: ``desired_state`` V14
    (positions [rad], velocities [rad/s]) is in their coordinates, ``true_desired_state`` where that
    takes the joints.
    """

    def __init__(self, errors: DrawnJointErrors) -> None:
        super().__init__()
        self._errors, n = errors, len(errors.zero)
        self._position = self.DeclareVectorInputPort("position", n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * n)
        q, of_torque = self._position, {self._position, self._torque, self.time_ticket()}
        for name, size, calc, inputs in (
            ("position_measured", n, lambda of: errors.position(q.Eval(of)), {q}),
            ("torque_estimated", n, self._calc_torque, of_torque),
            ("true_desired_state", 2 * n, self._calc_desired, {self._desired}),
        ):
            declare_output(self, name, calc, inputs, size=size)

    def _calc_torque(self, context: Context) -> Array:
        torque, q = self._torque.Eval(context), self._position.Eval(context)
        return self._errors.torque(torque, q, context.get_time())

    def _calc_desired(self, context: Context) -> Array:
        zero = np.concatenate([self._errors.zero, np.zeros_like(self._errors.zero)])
        return self._desired.Eval(context) - zero


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

    def _update(self, context: Context, state) -> None:
        state.set_value([self._next(context)])
