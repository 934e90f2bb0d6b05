"""Joint sensors of the simulated arm."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.arrays import Array
from feasigrasp.models.sensors.joint_errors import DrawnJointErrors
from feasigrasp.systems.ports import declare_output


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
        """The sensors of one arm."""
        super().__init__()
        self._errors, n = errors, len(errors.zero)
        self._position = self.DeclareVectorInputPort("position", n)
        self._torque = self.DeclareVectorInputPort("torque_external", n)
        self._desired = self.DeclareVectorInputPort("desired_state", 2 * n)
        position, torque = self._position.ticket(), self._torque.ticket()
        for name, size, calc, tickets in (
            ("position_measured", n, self._calc_position, {position}),
            ("torque_estimated", n, self._calc_torque, {position, torque, self.time_ticket()}),
            ("true_desired_state", 2 * n, self._calc_desired, {self._desired.ticket()}),
        ):
            declare_output(self, name, calc, tickets, size=size)

    def _calc_position(self, context: Context) -> Array:
        return self._errors.position(self._position.Eval(context))

    def _calc_torque(self, context: Context) -> Array:
        torque, q = self._torque.Eval(context), self._position.Eval(context)
        return self._errors.torque(torque, q, context.get_time())

    def _calc_desired(self, context: Context) -> Array:
        zero = np.concatenate([self._errors.zero, np.zeros_like(self._errors.zero)])
        return self._desired.Eval(context) - zero
