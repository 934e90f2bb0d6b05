"""Joint velocities that keep an arm inside its limits and out of collision, by a small QP.

A controller asks for a twist of the hand, for a joint velocity, or for both; this solves::

    min   1/2 |W (J qd - V)|^2 + rho/2 |qd - qd_0|^2
    s.t.  lower(q) <= qd <= upper(q)             joint velocity and position limits
          grad d_k(q) . qd >= -gain (d_k - d_safe)   every close pair of bodies k

The velocity bounds shrink with the distance to a position limit so that half of the joint's
acceleration suffices to stop in time. The collision rows are soft, so that a state that is already
too close is pushed out instead of making the problem infeasible. If the solver fails all the same,
the answer is to stop. The solver is DAQP (Arnstrom et al., "A dual active-set solver for embedded
quadratic programming using recursive LDL' updates", TAC 2022).
"""

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.iiwa import ACCELERATION_LIMITS, POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.self_collision import (
    distances_and_gradients,
    table_distances_and_gradients,
)

FloatArray = NDArray[np.float64]

_SOFT = 8  # DAQP's flag of a constraint that may be violated at a price


@dataclass(frozen=True)
class SafetyOptions:
    """How close the arm may come to its limits and to itself.

    Attributes:
        position_margin: Distance kept from the joint position limits [rad].
        limit_gain: A joint approaches its limit at most at gain x remaining distance [1/s].
        velocity_scale: Share of the velocity limits that may be used.
        clearance: Distance kept between bodies, and to the table [m].
        active_distance: Pairs that are farther apart than this are left out [m].
        collision_gain: Bodies approach at most at gain x remaining distance [1/s].
        rotation_weight: Weight of rad/s against m/s in following a twist.
        damping: rho, the weight of the preferred joint velocity.
    """

    position_margin: float = 0.01
    limit_gain: float = 5.0
    velocity_scale: float = 0.95
    clearance: float = 0.01
    active_distance: float = 0.08
    collision_gain: float = 4.0
    rotation_weight: float = 0.3
    damping: float = 1e-3


def velocity_bounds(q: FloatArray, options: SafetyOptions) -> tuple[FloatArray, FloatArray]:
    """Lower and upper joint velocity bounds at ``q``, shape (7,) each [rad/s]."""
    speed = options.velocity_scale * VELOCITY_LIMITS
    above = POSITION_LIMITS - options.position_margin - q
    below = POSITION_LIMITS - options.position_margin + q

    def towards_limit(room: FloatArray) -> FloatArray:
        braking = np.sqrt(ACCELERATION_LIMITS * np.maximum(room, 0.0))
        return np.asarray(np.minimum(np.minimum(braking, options.limit_gain * room), speed))

    # Beyond a limit the bound turns negative and leads back in, never faster than the joint can.
    upper = np.maximum(towards_limit(above), -speed)
    lower = -np.maximum(towards_limit(below), -speed)
    return lower, upper


def _collision_rows(q: FloatArray, options: SafetyOptions) -> tuple[FloatArray, FloatArray]:
    d_self, grad_self = distances_and_gradients(q)
    d_table, grad_table = table_distances_and_gradients(q)
    distance = np.concatenate([d_self, d_table])
    close = distance < options.active_distance
    rows = np.concatenate([grad_self, grad_table])[close]
    return rows, -options.collision_gain * (distance[close] - options.clearance)


def safe_velocity(
    q: FloatArray,
    qd_preferred: FloatArray,
    J: FloatArray | None = None,
    V: FloatArray | None = None,
    options: SafetyOptions | None = None,
) -> FloatArray:
    """The admissible joint velocity closest to what is asked for.

    Args:
        q: Joint positions [rad], shape (7,).
        qd_preferred: Preferred joint velocity [rad/s], shape (7,). With ``J`` it only fills the
            redundant directions; without, it is the request itself.
        J: Jacobian of the hand, shape (6, 7), rows [angular; linear].
        V: Desired twist of the hand [rad/s; m/s], shape (6,).
        options: Margins and gains.

    Returns:
        Joint velocity [rad/s], shape (7,); zero if a request is not finite or nothing is feasible.
    """
    options = options or SafetyOptions()
    if J is None or V is None:
        H, f = np.eye(7), -np.asarray(qd_preferred, dtype=float)
    else:
        weight = np.array([options.rotation_weight**2] * 3 + [1.0] * 3)
        weighted = J.T * weight
        H = weighted @ J + options.damping * np.eye(7)
        f = -(weighted @ V + options.damping * qd_preferred)
    if not (np.isfinite(q).all() and np.isfinite(f).all() and np.isfinite(H).all()):
        return np.zeros(7)
    lower, upper = velocity_bounds(q, options)
    rows, bound = _collision_rows(q, options)
    m = len(rows)
    qd, _, exit_flag, _ = daqp.solve(
        H,
        f,
        np.ascontiguousarray(rows),
        np.concatenate([upper, np.full(m, 1e30)]),
        np.concatenate([lower, bound]),
        np.concatenate([np.zeros(7, dtype=np.intc), np.full(m, _SOFT, dtype=np.intc)]),
    )
    if exit_flag <= 0 or not np.isfinite(qd).all():
        return np.zeros(7)
    return np.clip(qd, lower, upper)
