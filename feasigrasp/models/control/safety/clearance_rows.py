"""Compiled rows of the safety QP: how fast each close pair of bodies may approach.

A row is ``grad d . qd >= -gain (d - clearance)`` with the distance d of two capsules, of a
capsule's end and the table, or of one of the arm's balls and an obstacle. It is left out exactly
if no velocity between the bounds breaks it; what is left are a handful at most.
"""

import math

import numpy as np
from numba import njit

from feasigrasp.models.control.safety.obstacle_grid import grid_kernel
from feasigrasp.models.numerics.vectors import cross, dot, minus, step
from feasigrasp.models.robot.capsule_kernels import (
    add_lever,
    closest_parameters,
    end_point,
    link_poses_kernel,
    place,
)

#: No point of the arm is farther from a joint's axis [m]; a bound on how a joint moves it.
_LEVER = 1.5
_UP = (0.0, 0.0, 1.0)


@njit(cache=True, forceinline=True)
def _keep(row, lower, upper, bound):
    """Whether some velocity between the bounds breaks ``row . qd >= bound``."""
    slowest, moves = 0.0, False
    for j in range(7):
        slowest += min(row[j] * lower[j], row[j] * upper[j])
        moves = moves or abs(row[j]) > 1e-9
    return moves and slowest < bound


@njit(cache=True)
def rows_kernel(
    q,
    lower,
    upper,
    clearance,
    obstacle_clearance,
    table_height,
    gain,
    link,
    ends,
    radius,
    pairs,
    movers,
    ball_link,
    ball_center,
    ball_radius,
    grid,
    frame,
    rows,
    bounds,
):
    """Writes rows (m, 7) and their lower bounds (m,); returns m.

    Args as in `feasigrasp.models.robot.capsules.CapsuleModel`,
    `feasigrasp.models.control.safety.arm_balls` and
    `feasigrasp.models.control.safety.obstacle_grid`; ``lower`` and ``upper`` are the joints'
    velocity bounds (7,).
    """
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(q, R, p)
    placed = np.empty(ends.shape)
    for c in range(len(link)):
        for e in range(2):
            x, y, z = place(R, p, link[c], end_point(ends, c, e))
            placed[c, e, 0], placed[c, e, 1], placed[c, e, 2] = x, y, z
    # Nothing approaches faster than this, so what is farther than it allows needs no closer look.
    fastest = 0.0
    for j in range(7):
        fastest += _LEVER * max(abs(lower[j]), abs(upper[j]))
    far = max(clearance, obstacle_clearance) + fastest / gain

    m = 0
    rows[0] = 0.0
    for k in range(len(pairs)):
        i, j = pairs[k, 0], pairs[k, 1]
        a0, a1 = end_point(placed, i, 0), end_point(placed, i, 1)
        b0, b1 = end_point(placed, j, 0), end_point(placed, j, 1)
        _, t, d = closest_parameters(a0, a1, b0, b1)
        length = math.sqrt(dot(d, d))
        distance = length - radius[i] - radius[j]
        if distance > far or length < 1e-9:
            continue
        normal = -d[0] / length, -d[1] / length, -d[2] / length
        add_lever(step(b0, t, minus(b1, b0)), normal, link[i], link[j], R, p, rows[m])
        bounds[m] = -gain * (distance - clearance)
        if _keep(rows[m], lower, upper, bounds[m]):
            m += 1
        rows[m] = 0.0
    for k in range(len(movers)):
        c = movers[k]
        for e in range(2):
            distance = placed[c, e, 2] - radius[c] - table_height
            if distance > far:
                continue
            add_lever(end_point(placed, c, e), _UP, 0, link[c], R, p, rows[m])
            bounds[m] = -gain * (distance - clearance)
            if _keep(rows[m], lower, upper, bounds[m]):
                m += 1
            rows[m] = 0.0
    if grid.size == 0:
        return m
    for k in range(len(ball_link)):
        a = ball_center[k, 0], ball_center[k, 1], ball_center[k, 2]
        center = place(R, p, ball_link[k], a)
        height, slope = grid_kernel(center, grid, frame)
        distance = height - ball_radius[k]
        if distance > far:
            continue
        add_lever(center, slope, 0, ball_link[k], R, p, rows[m])
        bounds[m] = -gain * (distance - obstacle_clearance)
        if _keep(rows[m], lower, upper, bounds[m]):
            m += 1
        rows[m] = 0.0
    return m


@njit(cache=True)
def object_rows_kernel(
    q, lower, upper, clearance, gain, hand, grid, frame, X_WO, V_WO, rows, bounds
):
    """Writes rows (m, 7) and bounds (m,) that keep the hand off a moving object; returns m.

    ``hand`` are points of the open hand on link 7, shape (k, 3), ``grid`` and ``frame`` an
    `ObstacleGrid` in the object's frame. A point may approach the surface at most at gain x what is
    left beyond the clearance, relative to the surface as it moves: ``n . (v_point - v_surface)``.
    """
    if grid.size == 0 or not np.isfinite(X_WO.sum() + V_WO.sum()):
        return 0
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(q, R, p)
    m = 0
    rows[0] = 0.0
    for k in range(len(hand)):
        x = place(R, p, 7, (hand[k, 0], hand[k, 1], hand[k, 2]))
        lever = x[0] - X_WO[0, 3], x[1] - X_WO[1, 3], x[2] - X_WO[2, 3]
        x_O = (
            X_WO[0, 0] * lever[0] + X_WO[1, 0] * lever[1] + X_WO[2, 0] * lever[2],
            X_WO[0, 1] * lever[0] + X_WO[1, 1] * lever[1] + X_WO[2, 1] * lever[2],
            X_WO[0, 2] * lever[0] + X_WO[1, 2] * lever[1] + X_WO[2, 2] * lever[2],
        )
        distance, slope = grid_kernel(x_O, grid, frame)
        if distance >= frame[4]:
            continue
        normal = (
            X_WO[0, 0] * slope[0] + X_WO[0, 1] * slope[1] + X_WO[0, 2] * slope[2],
            X_WO[1, 0] * slope[0] + X_WO[1, 1] * slope[1] + X_WO[1, 2] * slope[2],
            X_WO[2, 0] * slope[0] + X_WO[2, 1] * slope[1] + X_WO[2, 2] * slope[2],
        )
        turning = cross((V_WO[0], V_WO[1], V_WO[2]), lever)
        surface = V_WO[3] + turning[0], V_WO[4] + turning[1], V_WO[5] + turning[2]
        add_lever(x, normal, 0, 7, R, p, rows[m])
        bounds[m] = dot(normal, surface) - gain * (distance - clearance)
        if _keep(rows[m], lower, upper, bounds[m]):
            m += 1
        rows[m] = 0.0
    return m
