"""What a closing hand and the object in it go through: squeeze, let go, lift, shake."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import ExternallyAppliedSpatialForce, MultibodyPlant
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from feasigrasp.models.objects.carrying import Load, carrying_wrench_kernel
from feasigrasp.systems.ports import declare_output
from feasigrasp.systems.station.object_servo import force_on

#: Rate at which the distance between the pads shrinks, as in grasping [m/s].
CLOSING_SPEED = 0.15
#: Commanded distance between closed pads: they squeeze whatever is between [m].
CLOSED = -0.05
#: The object is carried, as before any grasp, until the fingers have squeezed so long [s].
SQUEEZE_TIME = 0.15
#: Its weight comes on the fingers within this time; then the hand lifts, and shakes [s].
RAMP_TIME, LIFT_TIME, SHAKE_PERIOD = 0.1, 0.2, 0.25
#: Acceleration of the lift and amplitude of the shaking along x, y, z in turn [m/s^2].
LIFT, SHAKE = 2.0, 4.0
GRAVITY = 9.81
_SERVO_FREQUENCY = 60.0


def load(time: float) -> np.ndarray:
    """Acceleration of a free thing in the frame of the hand, ``time`` after it was let go.

    The hand points down: its approach direction z is that of gravity. What it does is told by
    d'Alembert's principle as forces on the object, while the hand stays where it is.

    Returns:
        In the grasp frame, shape (3,) [m/s^2].
    """
    acceleration = np.array([0.0, 0.0, GRAVITY * float(np.clip(time / RAMP_TIME, 0.0, 1.0))])
    lifting = time - RAMP_TIME
    if 0.0 <= lifting < LIFT_TIME:
        acceleration[2] += LIFT
    shaking = lifting - LIFT_TIME
    if shaking >= 0.0:
        axis = min(int(shaking / SHAKE_PERIOD), 2)
        acceleration[axis] += SHAKE * np.sin(2 * np.pi * shaking / SHAKE_PERIOD)
    return acceleration


class HandLoad(LeafSystem):
    """Closes the fingers of a hand that stays, and moves the object's weight onto them.

    .. pydrake_system::

        name: HandLoad
        input_ports:
        - state
        output_ports:
        - finger_state
        - spatial_force

    ``state`` is the object's V13 state; ``finger_state`` the desired position and speed of a finger
    (half the opening); ``spatial_force`` carries the object at its first pose until the fingers
    hold it, and is `load` times its mass from then on. That pose is a numeric parameter, see
    `set_pose`. The world is the grasp frame.

    Attributes:
        let_go: When the fingers have squeezed and the object is let go [s].
        end: When the last shake ends [s].
    """

    def __init__(self, plant: MultibodyPlant, body_index: BodyIndex, opening: float) -> None:
        """Loads one body of a finalized plant without gravity.

        Args:
            plant: The plant.
            body_index: The object; its origin is its centre of mass.
            opening: Distance between the open pads [m].
        """
        super().__init__()
        inertia = plant.get_body(body_index).default_spatial_inertia()
        self._body_index = body_index
        I_BBcm = inertia.CalcRotationalInertia().CopyToFullMatrix3()
        self._object = Load(inertia.get_mass(), I_BBcm, np.zeros(3), _SERVO_FREQUENCY)
        self._opening = opening
        self.let_go = opening / CLOSING_SPEED + SQUEEZE_TIME
        self.end = self.let_go + RAMP_TIME + LIFT_TIME + 3.0 * SHAKE_PERIOD
        self._state = self.DeclareVectorInputPort("state", 13)
        self._pose = self.DeclareNumericParameter(BasicVector(np.eye(4).ravel()))
        self.DeclareVectorOutputPort("finger_state", 2, self._calc_finger, {self.time_ticket()})
        force = [ExternallyAppliedSpatialForce()]
        declare_output(self, "spatial_force", self._calc_force, model=force)

    def set_pose(self, context: Context, X_GO: np.ndarray) -> None:
        """Sets where the object is carried, shape (4, 4)."""
        context.get_mutable_numeric_parameter(self._pose).SetFromVector(np.ravel(X_GO))

    def _calc_finger(self, context: Context, output: BasicVector) -> None:
        opening = self._opening - CLOSING_SPEED * context.get_time()
        closing = opening > CLOSED
        speed = -CLOSING_SPEED if closing else 0.0
        output.SetFromVector([0.5 * max(opening, CLOSED), 0.5 * speed])

    def _calc_force(self, context: Context) -> list[ExternallyAppliedSpatialForce]:
        wrench = np.zeros(6)
        since = context.get_time() - self.let_go
        if since < 0.0:
            X_GO = context.get_numeric_parameter(self._pose).value().reshape(4, 4)
            state, still = self._state.Eval(context), (np.zeros(6), np.zeros(3))
            carrying_wrench_kernel(state, np.ascontiguousarray(X_GO), *still, self._object, wrench)
        else:
            wrench[3:] = self._object.mass * load(since)
        return force_on(self._body_index, wrench)
