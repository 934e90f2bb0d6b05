"""Compiled matrices of the safety QP, and rounding of its solution."""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.safety.clearance_rows import (
    MOST_OBJECT_ROWS,
    Body,
    object_rows_kernel,
    rows_kernel,
)
from feasigrasp.models.control.safety.velocity_limits import bounds_kernel
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

_UNBOUNDED = 1e30
#: Requests are cut to this, far beyond what the arm can do, so that no square overflows.
_LARGEST_REQUEST = 1e3


@compiled
def _write_request(qd_preferred, J, V, rotation_weight, damping, H, f):
    """Writes the quadratic objective, H (7, 7) and f (7,); false if the request is not finite."""
    H[:] = 0.0
    weight = damping if len(V) > 0 else 1.0
    for i in range(IIWA_7.joints):
        wish = min(max(qd_preferred[i], -_LARGEST_REQUEST), _LARGEST_REQUEST)
        H[i, i] = weight
        f[i] = -weight * wish
    total = 0.0
    for r in range(len(V)):
        square = rotation_weight**2 if r < 3 else 1.0
        wish = min(max(V[r], -_LARGEST_REQUEST), _LARGEST_REQUEST)
        total += V[r]
        for i in range(IIWA_7.joints):
            scaled = square * J[r, i]
            f[i] -= scaled * wish
            for j in range(IIWA_7.joints):
                H[i, j] += scaled * J[r, j]
    for i in range(IIWA_7.joints):
        total += qd_preferred[i] + f[i]
        for j in range(IIWA_7.joints):
            total += H[i, j]
    return np.isfinite(total)


@compiled
def stop_kernel(H, f):
    """Writes the objective of standing still."""
    f[:] = 0.0
    for i in range(IIWA_7.joints):
        for j in range(IIWA_7.joints):
            H[i, j] = 1.0 if i == j else 0.0


@compiled
def problem_kernel(
    q,
    qd_preferred,
    J,
    V,
    qd_last,
    options,
    link,
    ends,
    radius,
    pairs,
    movers,
    ball_link,
    ball_center,
    ball_radius,
    guarded,
    grid,
    frame,
    object_grid,
    object_frame,
    X_WO,
    V_WO,
    extra_clearance,
    matrix,
    vector,
):
    """Writes the QP; returns the number of hard rows, -1 if the state is not finite, and of all.

    Everything in two arrays, since making a NumPy array costs as much as filling it: ``matrix``
    has H (7, 7) and below it the rows (m, 7), ``vector`` the lines lower bounds, upper bounds and
    f. The arguments, from ``link`` to ``guarded`` those of `Body`, are single arrays, since numba
    takes ten times as long to unpack a tuple.
    """
    settings = options[0]
    lower, upper, f = vector[0], vector[1], vector[2, :7]
    state = 0.0
    for i in range(IIWA_7.joints):
        state += q[i] + (qd_last[i] if len(qd_last) > 0 else 0.0)
    if not np.isfinite(state):
        return -1, -1
    bounds_kernel(q, qd_last, settings, lower, upper)
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(q, R, p)
    body = Body(link, ends, radius, pairs, movers, ball_link, ball_center, ball_radius, guarded)
    m = rows_kernel(
        R,
        p,
        lower,
        upper,
        settings,
        body,
        grid,
        frame,
        matrix[IIWA_7.joints :],
        lower[IIWA_7.joints :],
    )
    total = m + object_rows_kernel(
        *(R, p, lower, upper, settings, guarded, object_grid, object_frame, X_WO, V_WO),
        *(extra_clearance, MOST_OBJECT_ROWS, matrix[7 + m :], lower[7 + m :]),
    )
    upper[7 : 7 + total] = _UNBOUNDED
    if not _write_request(
        qd_preferred, J, V, settings.rotation_weight, settings.damping, matrix[: IIWA_7.joints], f
    ):
        stop_kernel(matrix[: IIWA_7.joints], f)
    return m, total


@compiled
def clip_kernel(qd, vector):
    """Rounds a solution into the joints' bounds; false if it is not finite."""
    total = 0.0
    for i in range(IIWA_7.joints):
        total += qd[i]
        qd[i] = min(max(qd[i], vector[0, i]), vector[1, i])
    return np.isfinite(total)


@compiled
def brake_kernel(qd_last, acceleration_scale, period):
    """The next velocity (7,) of braking from the last one; zero where not finite."""
    qd = np.zeros(IIWA_7.joints)
    for i in range(len(qd_last)):
        change = acceleration_scale * IIWA_7.acceleration_limits[i] * period
        if np.isfinite(qd_last[i]):
            qd[i] = qd_last[i] - min(max(qd_last[i], -change), change)
    return qd
