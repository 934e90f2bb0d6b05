"""Compiled rows of the safety QP: velocity dampers between close pairs (Faverjon 1987).

A row is ``grad d . qd >= -gain (d - clearance)`` with the distance d of two capsules, of a
capsule's end and the table, or of one of the arm's balls and an obstacle, each with a clearance of
its own. It is left out exactly if no velocity between the bounds breaks it; what is left are a
handful at most.
"""

import math
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.obstacle_grid import box_distance_kernel, grid_kernel
from feasigrasp.models.numerics.vectors import cross, dot, minus, step
from feasigrasp.models.robot.capsule_kernels import (
    add_lever,
    closest_parameters,
    end_point,
    place,
)
from feasigrasp.models.robot.iiwa import IIWA_7

#: So many rows keep off an object at most. A hand that opens round it has hundreds of points inside
#: their clearance, most of them beside each other: the QP would take several ticks for them.
MOST_OBJECT_ROWS = 64
#: Share of the speed of approach that is left in the reserve. Were nothing left, or had the hand to
#: leave it, fingers on both sides of an object could get stuck.
_SLOW_APPROACH = 0.2
#: No point of the arm is farther from a joint's axis [m]; a bound on how a joint moves it.
_LEVER = 1.5
_UP = (0.0, 0.0, 1.0)


class Body(NamedTuple):
    """The arm with its hand.

    Attributes:
        link: As in `feasigrasp.models.robot.capsules.CapsuleModel`, like the next four.
        ends: Ends of the capsules.
        radius: Their radii.
        pairs: Those that can come close.
        movers: Those that can come close to the table.
        ball_link: As in `feasigrasp.models.robot.capsules.ArmBalls`, like the next two.
        ball_center: Centres of the balls.
        ball_radius: Their radii.
        guarded: What is kept off an object: points on the outside of the open hand and balls that
            cover the arm, a line of link, x, y, z and radius each, shape (k, 5) [m].
    """

    link: Indices
    ends: Array
    radius: Array
    pairs: Indices
    movers: Indices
    ball_link: Indices
    ball_center: Array
    ball_radius: Array
    guarded: Array


@compiled(forceinline=True)
def _keep(rows, bounds, m, bound, lower, upper):
    """Takes row m if some velocity between the bounds breaks it; returns how many rows there are.

    The next row is cleared.
    """
    row = rows[m]
    slowest, moves = 0.0, False
    for j in range(IIWA_7.joints):
        slowest += min(row[j] * lower[j], row[j] * upper[j])
        moves = moves or abs(row[j]) > 1e-9
    bounds[m] = bound
    m += moves and slowest < bound
    rows[m] = 0.0
    return m


@compiled
def rows_kernel(R, p, lower, upper, options, body, grid, frame, rows, bounds):
    """Writes rows (m, 7) and their lower bounds (m,); returns m.

    ``R`` and ``p`` are the links' poses, ``lower`` and ``upper`` the joints' velocity bounds (7,),
    ``options`` `SafetyOptions` as a record, ``grid`` and ``frame`` those of an `ObstacleGrid`.
    """
    link, radius, gain = body.link, body.radius, options.approach_gain
    placed = np.empty(body.ends.shape)
    for c in range(len(link)):
        for e in range(2):
            x, y, z = place(R, p, link[c], end_point(body.ends, c, e))
            placed[c, e, 0], placed[c, e, 1], placed[c, e, 2] = x, y, z
    # Nothing approaches faster than this, so what is farther than it allows needs no closer look.
    fastest = 0.0
    for j in range(IIWA_7.joints):
        fastest += _LEVER * max(abs(lower[j]), abs(upper[j]))
    far = max(options.clearance, options.obstacle_clearance, options.table_clearance)
    far += fastest / gain

    m = 0
    rows[0] = 0.0
    for k in range(len(body.pairs)):
        i, j = body.pairs[k, 0], body.pairs[k, 1]
        a0, a1 = end_point(placed, i, 0), end_point(placed, i, 1)
        b0, b1 = end_point(placed, j, 0), end_point(placed, j, 1)
        _, t, d = closest_parameters(a0, a1, b0, b1)
        length = math.sqrt(dot(d, d))
        distance = length - radius[i] - radius[j]
        if distance > far or length < 1e-9:
            continue
        normal = -d[0] / length, -d[1] / length, -d[2] / length
        add_lever(step(b0, t, minus(b1, b0)), normal, link[i], link[j], R, p, rows[m])
        m = _keep(rows, bounds, m, -gain * (distance - options.clearance), lower, upper)
    for k in range(len(body.movers)):
        c = body.movers[k]
        for e in range(2):
            distance = placed[c, e, 2] - radius[c] - options.table_height
            if distance > far:
                continue
            add_lever(end_point(placed, c, e), _UP, 0, link[c], R, p, rows[m])
            m = _keep(rows, bounds, m, -gain * (distance - options.table_clearance), lower, upper)
    if grid.size == 0:
        return m
    for k in range(len(body.ball_link)):
        a = body.ball_center[k, 0], body.ball_center[k, 1], body.ball_center[k, 2]
        center = place(R, p, body.ball_link[k], a)
        height, slope = grid_kernel(center, grid, frame)
        distance = height - body.ball_radius[k]
        if distance > far:
            continue
        add_lever(center, slope, 0, body.ball_link[k], R, p, rows[m])
        m = _keep(rows, bounds, m, -gain * (distance - options.obstacle_clearance), lower, upper)
    return m


@compiled
def object_rows_kernel(
    R,
    p,
    lower,
    upper,
    options,
    guarded,
    grid,
    frame,
    X_WO,
    V_WO,
    extra_clearance,
    most,
    rows,
    bounds,
):
    """Writes rows (m, 7) and bounds (m,) that keep arm and hand off a moving object; returns m.

    ``grid`` and ``frame`` are an `ObstacleGrid` in the object's frame; ``guarded`` holds what is
    kept off, one line of link, x, y, z and radius each: points of the hand (radius 0), which keep a
    small clearance, and balls that cover the arm, which keep the one to obstacles. Either may
    approach the surface at most at gain x what is left beyond the clearance, a slow hand at a
    larger one, relative to the surface as it moves: ``n . (v_point - v_surface)``; points of the
    hand that are no farther off than the ``extra_clearance`` a lot slower. Of more than ``most``
    those are kept that ask for the greatest speed away from it.
    """
    if grid.size == 0 or not np.isfinite(X_WO.sum() + V_WO.sum()):
        return 0
    # Nothing approaches faster than this, so what is farther than it allows needs no closer look.
    fastest = math.sqrt(V_WO[3] ** 2 + V_WO[4] ** 2 + V_WO[5] ** 2)
    turning_rate = math.sqrt(V_WO[0] ** 2 + V_WO[1] ** 2 + V_WO[2] ** 2)
    for j in range(IIWA_7.joints):
        fastest += _LEVER * max(abs(lower[j]), abs(upper[j]))
    m = 0
    rows[0] = 0.0
    for k in range(len(guarded)):
        link, radius = int(guarded[k, 0]), guarded[k, 4]
        x = place(R, p, link, (guarded[k, 1], guarded[k, 2], guarded[k, 3]))
        lever = x[0] - X_WO[0, 3], x[1] - X_WO[1, 3], x[2] - X_WO[2, 3]
        x_O = (
            X_WO[0, 0] * lever[0] + X_WO[1, 0] * lever[1] + X_WO[2, 0] * lever[2],
            X_WO[0, 1] * lever[0] + X_WO[1, 1] * lever[1] + X_WO[2, 1] * lever[2],
            X_WO[0, 2] * lever[0] + X_WO[1, 2] * lever[1] + X_WO[2, 2] * lever[2],
        )
        distance, slope = grid_kernel(x_O, grid, frame)
        if distance >= 0.999 * frame[4]:
            distance, slope = box_distance_kernel(x_O, grid.shape, frame)
            if distance <= 0.0:
                continue
            # Over the mouth of a bowl the box is near, and the surface is not.
            distance = max(distance, frame[4])
        if radius == 0.0:
            left = distance - options.object_clearance
            # Within the clearance, left < 0, there is no reserve any more.
            left = max(left - extra_clearance, min(left, _SLOW_APPROACH * left))
            allowed = min(options.object_gain * left, options.slow + options.approach_gain * left)
        else:
            allowed = options.approach_gain * (distance - radius - options.obstacle_clearance)
        if allowed > fastest + turning_rate * math.sqrt(dot(lever, lever)):
            continue
        normal = (
            X_WO[0, 0] * slope[0] + X_WO[0, 1] * slope[1] + X_WO[0, 2] * slope[2],
            X_WO[1, 0] * slope[0] + X_WO[1, 1] * slope[1] + X_WO[1, 2] * slope[2],
            X_WO[2, 0] * slope[0] + X_WO[2, 1] * slope[1] + X_WO[2, 2] * slope[2],
        )
        turning = cross((V_WO[0], V_WO[1], V_WO[2]), lever)
        surface = V_WO[3] + turning[0], V_WO[4] + turning[1], V_WO[5] + turning[2]
        add_lever(x, normal, 0, link, R, p, rows[m])
        m = _keep(rows, bounds, m, dot(normal, surface) - allowed, lower, upper)
    if m > most:
        kept = np.sort(np.argsort(-bounds[:m])[:most])
        for i in range(most):
            rows[i], bounds[i] = rows[kept[i]], bounds[kept[i]]
        m = most
    return m
