"""Inverse kinematics of the iiwa 7 in closed form: all solutions, the nearest one, diverse ones.

For a flange pose and an arm angle there are eight configurations: the signs of the shoulder, elbow
and wrist joints 2, 4 and 6 (see `feasigrasp.models.ik.arm_circle` for the formulas and the
conventions at singularities). Joint limits are looked at here, collisions in
`feasigrasp.models.reach.reachability`. The iterative counterpart is
`feasigrasp.models.ik.least_squares`.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.ik.arm_angle_table import lanes_kernel, travel_times_kernel
from feasigrasp.models.ik.arm_circle import (
    arm_angle_kernel,
    arm_circle_kernel,
    closed_form_kernel,
    configuration_kernel,
)
from feasigrasp.models.robot.iiwa import IIWA_7


@njit(cache=True)
def inside_limits_kernel(q, margin):
    """Whether every joint stays ``margin`` [rad] away from its limits."""
    for i in range(IIWA_7.joints):  # noqa: SIM110 - numba compiles the loop, not all()
        if not abs(q[i]) <= IIWA_7.position_limits[i] - margin:
            return False
    return True


@njit(cache=True)
def travel_time_kernel(q_a, q_b):
    """max_j |dq_j| / v_j: the least time from one configuration to the other [s]."""
    worst = 0.0
    for i in range(IIWA_7.joints):
        worst = max(worst, abs(q_a[i] - q_b[i]) / IIWA_7.velocity_limits[i])
    return worst


@njit(cache=True)
def next_nearest_kernel(circle, lanes, q):
    """Takes the least travel time out of the lanes and writes its configuration (7,).

    Returns that time [s], infinite if nothing is left.
    """
    m = len(lanes.sine)
    times = lanes.time.reshape(-1)
    index = np.argmin(times)
    shortest = times[index]
    if shortest < np.inf:
        times[index] = np.inf
        row, lane = index // m, index % m
        elbow = lanes.elbow[lane]
        branch = row if elbow > 0.0 else 4 + row
        configuration_kernel(
            circle, elbow * lanes.sine[lane], elbow * lanes.cosine[lane], branch, q
        )
    return shortest


@njit(cache=True)
def _nearest_batch(X_WF, q_near, psis, margin, q, times):
    lanes = lanes_kernel(psis, np.nan)
    candidate = np.empty(IIWA_7.joints)
    for n in range(len(X_WF)):
        q[n], times[n] = np.nan, np.inf
        circle = arm_circle_kernel(X_WF[n])
        if not circle.reached:
            continue
        travel_times_kernel(circle, q_near, margin, lanes)
        while next_nearest_kernel(circle, lanes, candidate) < np.inf:
            # Angles next to a singularity are rough until the configuration is written.
            if inside_limits_kernel(candidate, margin):
                q[n] = candidate
                times[n] = travel_time_kernel(candidate, q_near)
                break


def closed_form(X_WF: ArrayLike, psi: float) -> Array:
    """All configurations that reach a flange pose with a given arm angle, limits not considered.

    Args:
        X_WF: Flange pose, shape (4, 4) [m].
        psi: Arm angle [rad].

    Returns:
        Shape (8, 7) [rad], or (0, 7) if the wrist centre is out of reach or ``X_WF`` is no pose (an
        entry is not finite, or its rotation none). Row ``4 elbow + 2 shoulder + wrist``: 0 where
        joint 4, 2 or 6 is positive, 1 where it is negative.
    """
    out = np.empty((8, IIWA_7.joints))
    count = closed_form_kernel(np.ascontiguousarray(X_WF, dtype=float), float(psi), out)
    return out[:count]


def arm_angle(q: ArrayLike) -> float:
    """Arm angle of a configuration [rad]: with it, `closed_form` of its flange pose contains it."""
    return float(arm_angle_kernel(np.asarray(q, dtype=float)))


def nearest_inside_limits(
    X_WF: ArrayLike, q: ArrayLike, psis: ArrayLike, *, margin: float = 0.0
) -> tuple[Array, Array]:
    """For each flange pose the configuration inside the limits that is soonest reached from ``q``.

    Args:
        X_WF: Flange poses in the base frame, shape (n, 4, 4) [m].
        q: Present joint positions [rad], shape (7,).
        psis: Arm angles to try, each in all eight branches [rad], shape (m,).
        margin: Distance kept from the joint limits [rad].

    Returns:
        Configurations (n, 7) [rad], NaN where there is none, and travel times (n,) [s],
        ``max_j |dq_j| / v_j``, infinite where there is none.

    Raises:
        ValueError: ``X_WF`` or ``q`` has another shape.
    """
    poses = flange_poses(X_WF)
    near = np.ascontiguousarray(q, dtype=float)
    if near.shape != (IIWA_7.joints,):
        raise ValueError(f"the present joint positions must have shape (7,), got {near.shape}")
    angles = np.ascontiguousarray(psis, dtype=float).reshape(-1)
    found, times = np.empty((len(poses), IIWA_7.joints)), np.empty(len(poses))
    if len(angles) == 0:
        return np.full_like(found, np.nan), np.full_like(times, np.inf)
    _nearest_batch(poses, near, angles, float(margin), found, times)
    return found, times


def flange_poses(X_WF: ArrayLike) -> Array:
    """Poses as the kernels take them: contiguous, (n, 4, 4); one pose may come as (4, 4).

    Raises:
        ValueError: Another shape.
    """
    poses = np.ascontiguousarray(X_WF, dtype=float)
    if poses.shape[-2:] != (4, 4) or poses.ndim > 3:
        raise ValueError(f"poses must have shape (n, 4, 4), got {poses.shape}")
    return poses.reshape(-1, 4, 4)
