"""Wrench of a critically damped spatial spring that moves a free body along a motion."""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import rotation_kernel, so3_log_kernel
from feasigrasp.models.objects.motion import motion_kernel


class DrivenBody(NamedTuple):
    """A body with its origin at the center of mass, and the spring that drives it.

    Attributes:
        mass: [kg].
        I_BBcm: Rotational inertia about the centre of mass, in B, shape (3, 3) [kg m^2].
        gravity: Shape (3,) [m/s^2].
        frequency: w of the spring [rad/s].
        max_force: Of the spring [N].
        max_torque: Of the spring [Nm].
    """

    mass: float
    I_BBcm: Array
    gravity: Array
    frequency: float
    max_force: float = np.inf
    max_torque: float = np.inf


@compiled
def drive_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench):
    """Writes torque and force [Nm; N] in the world, to be applied at the centre of mass.

    With the errors e of position and angle, the force is ``m (w^2 e + 2 w de/dt + a - g)`` and the
    torque ``I (w^2 e + 2 w de/dt) + omega x I omega``, however large.

    Args:
        state: Quaternion wxyz, position, angular velocity, velocity of the body, shape (13,).
        X_WR: Reference pose, shape (4, 4).
        V_WR: Reference twist [angular; linear], shape (6,).
        acceleration: Reference acceleration of the origin, shape (3,) [m/s^2].
        load: The body and its spring.
        wrench: Receives the result, shape (6,).
    """
    R_WB = np.empty((3, 3))
    rotation_kernel(state[:4], R_WB)
    w, mass, gravity = load.frequency, load.mass, load.gravity
    angle_error = so3_log_kernel(np.ascontiguousarray(X_WR[:3, :3]) @ R_WB.T)
    omega = state[7:10]
    I_WB = R_WB @ load.I_BBcm @ R_WB.T
    turning = w * w * angle_error + 2.0 * w * (V_WR[:3] - omega)
    L = I_WB @ omega
    torque = I_WB @ turning
    wrench[0] = torque[0] + omega[1] * L[2] - omega[2] * L[1]
    wrench[1] = torque[1] + omega[2] * L[0] - omega[0] * L[2]
    wrench[2] = torque[2] + omega[0] * L[1] - omega[1] * L[0]
    for i in range(3):
        p_error, v_error = X_WR[i, 3] - state[4 + i], V_WR[3 + i] - state[10 + i]
        wrench[3 + i] = mass * (w * w * p_error + 2.0 * w * v_error + acceleration[i] - gravity[i])


@compiled
def motion_wrench_kernel(state, parameters, t, load, wrench):
    """The wrench of `spring_wrench_kernel` towards a `HarmonicMotion` at time t [s]."""
    X_WR, V_WR, acceleration = motion_kernel(parameters, t)
    spring_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench)


@compiled
def spring_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench):
    """The wrench of `drive_wrench_kernel` by a spring that gives way.

    Torque and force of the spring are shortened to what it can; what carries the body's weight and
    its reference acceleration comes on top.
    """
    drive_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench)
    carried = load.mass * (acceleration - load.gravity)
    spring = wrench[3:] - carried
    force, torque = np.sqrt(np.sum(spring**2)), np.sqrt(np.sum(wrench[:3] ** 2))
    wrench[:3] *= min(1.0, load.max_torque / max(torque, 1e-12))
    wrench[3:] = carried + spring * min(1.0, load.max_force / max(force, 1e-12))


@compiled
def body_pose_kernel(state):
    """Pose (4, 4) out of a floating body's state (quaternion wxyz, position, velocities)."""
    X_WB = np.eye(4)
    rotation_kernel(state, X_WB)
    X_WB[:3, 3] = state[4:7]
    return X_WB
