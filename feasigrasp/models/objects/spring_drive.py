"""Wrench of a damped spatial spring that moves a free body along a motion."""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import rotation_kernel, so3_log_kernel
from feasigrasp.models.objects.motion import motion_kernel

#: Damping ratio of a carried object: near that of a human arm, and it settles within one swing.
#: Source: guessed.
DAMPING_RATIO = 0.5
#: Largest ``w dt`` of a spring that is integrated explicitly. With the damping ratio z the step is
#: stable up to ``w dt = 2 (sqrt(1 + z^2) - z)``, 1.24 here. Source: numerical.
LARGEST_STEP = 1.1


class Compliance(StrEnum):
    """How firmly a carrier holds the object."""

    SOFT = "soft"
    STIFF = "stiff"
    RIGID = "rigid"


class Spring(NamedTuple):
    """The spring between a carrier and the object that it holds.

    Attributes:
        stiffness: [N/m].
        angular_stiffness: [Nm/rad].
        max_force: It gives way beyond this force [N].
        max_torque: The same for the torque [Nm].
    """

    stiffness: float
    angular_stiffness: float
    max_force: float
    max_torque: float


#: A relaxed hand, a tensed hand, and the flange of a robot or a fixture on a conveyor. Those of
#: hands are choices: posture and co-contraction change a human hand's stiffness (Gomi and Osu,
#: J. Neuroscience 18(21), 1998; figures not verified at the source). A flange is as stiff as the
#: simulated arm at its hand: 6000 Nm/rad at a lever of 0.7 m.
SPRINGS = {
    Compliance.SOFT: Spring(300.0, 3.0, 20.0, 2.0),
    Compliance.STIFF: Spring(1000.0, 10.0, 30.0, 3.0),
    Compliance.RIGID: Spring(10_000.0, 100.0, 100.0, 10.0),
}


class Release(StrEnum):
    """When a carrier lets the object go, after the command to."""

    LATE = "late"
    LOAD = "load"


class CarrierHold(NamedTuple):
    """How a carrier holds the object, and lets it go.

    Attributes:
        spring: Between carrier and object.
        release: When it lets go after the command to.
        delay: With `Release.LATE`, how much later [s].
    """

    spring: Spring
    release: Release = Release.LATE
    delay: float = 0.0


class DrivenBody(NamedTuple):
    """A body with its origin at the center of mass, and the spring that drives it.

    Attributes:
        mass: [kg].
        I_BBcm: Rotational inertia about the centre of mass, in B, shape (3, 3) [kg m^2].
        gravity: Shape (3,) [m/s^2].
        stiffness: k of the spring [N/m].
        damping: c [N s/m].
        K_B: Angular stiffness in B, shape (3, 3) [Nm/rad].
        D_B: Angular damping in B, shape (3, 3) [Nm s/rad].
        max_force: Of the spring [N].
        max_torque: Of the spring [Nm].
    """

    mass: float
    I_BBcm: Array
    gravity: Array
    stiffness: float
    damping: float
    K_B: Array
    D_B: Array
    max_force: float = np.inf
    max_torque: float = np.inf


def carried_body(
    mass: float, I_BBcm: Array, gravity: Array, spring: Spring, step: float
) -> DrivenBody:
    """A body on a spring with `DAMPING_RATIO`, along and about every axis.

    The time step integrates no stiffer spring than ``m (w/dt)^2`` along an axis, and ``i (w/dt)^2``
    about a principal axis with the inertia i, with w of `LARGEST_STEP`: there it is softer. Body
    and ``gravity`` are as of `DrivenBody`, ``step`` [s] is that of the simulation.
    """
    stiffest = (LARGEST_STEP / step) ** 2
    inertia, axes = np.linalg.eigh(I_BBcm)
    k = min(spring.stiffness, stiffest * mass)
    turning = np.minimum(spring.angular_stiffness, stiffest * inertia)
    c = float(2.0 * DAMPING_RATIO * np.sqrt(k * mass))
    damping = 2.0 * DAMPING_RATIO * np.sqrt(turning * inertia)
    K_B, D_B = ((axes * each) @ axes.T for each in (turning, damping))
    limits = spring.max_force, spring.max_torque
    return DrivenBody(mass, I_BBcm, gravity, k, c, K_B, D_B, *limits)


@compiled
def drive_wrench_kernel(state, X_WR, V_WR, acceleration, load, wrench):
    """Writes torque and force [Nm; N] in the world, to be applied at the centre of mass.

    With the errors e of position and angle, the force is ``k e + c de/dt + m (a - g)`` and the
    torque ``K e + D de/dt + omega x I omega``, however large.

    Args:
        state: Quaternion wxyz, position, angular velocity, velocity of the body, shape (13,).
        X_WR: Reference pose, shape (4, 4).
        V_WR: Reference twist [angular; linear], shape (6,).
        acceleration: Reference acceleration of the origin, shape (3,) [m/s^2].
        load: A `DrivenBody`.
        wrench: Written, shape (6,).
    """
    R_WB = np.empty((3, 3))
    rotation_kernel(state[:4], R_WB)
    mass, gravity = load.mass, load.gravity
    angle_error = so3_log_kernel(np.ascontiguousarray(X_WR[:3, :3]) @ R_WB.T)
    omega = state[7:10]
    R_BW = np.ascontiguousarray(R_WB.T)
    L = R_WB @ (load.I_BBcm @ (R_BW @ omega))
    torque = R_WB @ (load.K_B @ (R_BW @ angle_error) + load.D_B @ (R_BW @ (V_WR[:3] - omega)))
    wrench[0] = torque[0] + omega[1] * L[2] - omega[2] * L[1]
    wrench[1] = torque[1] + omega[2] * L[0] - omega[0] * L[2]
    wrench[2] = torque[2] + omega[0] * L[1] - omega[1] * L[0]
    for i in range(3):
        p_error, v_error = X_WR[i, 3] - state[4 + i], V_WR[3 + i] - state[10 + i]
        carried = mass * (acceleration[i] - gravity[i])
        wrench[3 + i] = load.stiffness * p_error + load.damping * v_error + carried


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
