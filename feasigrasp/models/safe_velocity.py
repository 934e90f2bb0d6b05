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
import numba as nb
import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.capsule_kernels import gradients_kernel, table_kernel
from feasigrasp.models.iiwa import ACCELERATION_LIMITS, POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.self_collision import IIWA_CAPSULES

FloatArray = NDArray[np.float64]

_SOFT = 8  # DAQP's flag of a constraint that may be violated at a price
_UNBOUNDED = 1e30
_IDENTITY = np.eye(7)


@dataclass(frozen=True)
class SafetyOptions:
    """How close the arm may come to its limits and to itself.

    Attributes:
        position_margin: Distance kept from the joint position limits [rad].
        limit_gain: A joint approaches its limit at most at gain x remaining distance [1/s].
        velocity_scale: Share of the velocity limits that may be used.
        clearance: Distance kept between bodies, and to the table [m].
        active_distance: Pairs that are farther apart than this are left out [m].
        table_height: Height of the table top in the base frame [m].
        collision_gain: Bodies approach at most at gain x remaining distance [1/s].
        rotation_weight: Weight of rad/s against m/s in following a twist.
        damping: rho, the weight of the preferred joint velocity.
    """

    position_margin: float = 0.03
    limit_gain: float = 5.0
    velocity_scale: float = 0.85
    clearance: float = 0.01
    active_distance: float = 0.08
    table_height: float = 0.0
    collision_gain: float = 4.0
    rotation_weight: float = 0.3
    damping: float = 1e-3


@nb.njit(cache=True)
def bounds_kernel(q, margin, limit_gain, velocity_scale, lower, upper):  # type: ignore[no-untyped-def]
    """Writes joint velocity bounds into the first seven entries of ``lower`` and ``upper``."""
    for i in range(7):
        speed = velocity_scale * VELOCITY_LIMITS[i]
        above = POSITION_LIMITS[i] - margin - q[i]
        below = POSITION_LIMITS[i] - margin + q[i]
        # Beyond a limit the bound turns negative and leads back in, no faster than the joint can.
        up = min(np.sqrt(ACCELERATION_LIMITS[i] * max(above, 0.0)), limit_gain * above, speed)
        down = min(np.sqrt(ACCELERATION_LIMITS[i] * max(below, 0.0)), limit_gain * below, speed)
        upper[i] = max(up, -speed)
        lower[i] = -max(down, -speed)


@nb.njit(cache=True)
def constraints_kernel(  # type: ignore[no-untyped-def]
    q,
    model,
    margin,
    limit_gain,
    velocity_scale,
    clearance,
    active_distance,
    table_height,
    collision_gain,
    lower,
    rows,
):
    """Writes lower bounds and rows of what is close; returns upper bounds and the rows' number."""
    pairs, movers = len(model.pairs), len(model.movers)
    total = pairs + 2 * movers
    upper = np.full(7 + total, _UNBOUNDED)
    bounds_kernel(q, margin, limit_gain, velocity_scale, lower, upper)
    distance, gradient = np.empty(total), np.empty((total, 7))
    gradients_kernel(q, model, distance[:pairs], gradient[:pairs])
    above_table, slopes = np.empty((movers, 2)), np.empty((movers, 2, 7))
    table_kernel(q, model, table_height, above_table, slopes)
    distance[pairs:] = above_table.ravel()
    gradient[pairs:] = slopes.reshape(2 * movers, 7)
    m = 0
    for k in range(total):
        if distance[k] < active_distance:
            rows[m] = gradient[k]
            lower[7 + m] = -collision_gain * (distance[k] - clearance)
            m += 1
    return upper, m


def velocity_bounds(q: FloatArray, options: SafetyOptions) -> tuple[FloatArray, FloatArray]:
    """Lower and upper joint velocity bounds at ``q``, shape (7,) each [rad/s]."""
    lower, upper = np.empty(7), np.empty(7)
    q = np.ascontiguousarray(q, dtype=float)
    bounds_kernel(
        q, options.position_margin, options.limit_gain, options.velocity_scale, lower, upper
    )
    return lower, upper


@nb.njit(cache=True)
def _objective_kernel(J, V, qd_preferred, rotation_weight, damping):  # type: ignore[no-untyped-def]
    """Matrix (7, 7) and vector (7,) of the quadratic objective."""
    WJ = J.copy()
    WJ[:3] *= rotation_weight**2
    H = WJ.T @ J
    f = -(WJ.T @ V)
    for i in range(7):
        H[i, i] += damping
        f[i] -= damping * qd_preferred[i]
    return H, f


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
        H, f = _IDENTITY, -np.asarray(qd_preferred, dtype=float)
    else:
        H, f = _objective_kernel(J, V, qd_preferred, options.rotation_weight, options.damping)
    if not np.isfinite(q.sum() + f.sum() + H.sum()):
        return np.zeros(7)
    most = len(IIWA_CAPSULES.pairs) + 2 * len(IIWA_CAPSULES.movers)
    lower, rows = np.empty(7 + most), np.empty((most, 7))
    upper, m = constraints_kernel(
        np.ascontiguousarray(q, dtype=float),
        IIWA_CAPSULES,
        options.position_margin,
        options.limit_gain,
        options.velocity_scale,
        options.clearance,
        options.active_distance,
        options.table_height,
        options.collision_gain,
        lower,
        rows,
    )
    kinds = np.full(7 + m, _SOFT, dtype=np.intc)
    kinds[:7] = 0
    qd, _, exit_flag, _ = daqp.solve(H, f, rows[:m], upper[: 7 + m], lower[: 7 + m], kinds)
    if exit_flag <= 0 or not np.isfinite(qd).all():
        return np.zeros(7)
    return np.clip(qd, lower[:7], upper[:7])
