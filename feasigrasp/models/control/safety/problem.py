"""Compiled matrices of the safety QP: velocity dampers between close pairs (Faverjon 1987).

A row is ``grad d . qd >= -gain (d - clearance)`` with the distance d of two capsules, of a
capsule's end and the table, or of one of the arm's balls and an obstacle, each with a clearance of
its own. It is left out exactly if no velocity between the bounds breaks it; what is left are a
handful at most.
"""

import math
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Float32, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.safety.velocity_limits import bounds_kernel
from feasigrasp.models.geometry.obstacle_grid import box_distance_kernel, grid_kernel
from feasigrasp.models.numerics.vectors import cross, dot, minus, step
from feasigrasp.models.robot.capsule_kernels import (
    add_lever,
    closest_parameters,
    end_point,
    link_poses_kernel,
    place,
)

#: Largest number of rows of an object. A hand that opens round it has hundreds of points inside
#: their clearance, most of them beside each other: the QP would take several ticks for them.
#: Source: reasoned.
MOST_OBJECT_ROWS = 64
#: No point of the arm is farther from a joint's axis [m]; a bound on how a joint moves it. Source:
#: reasoned: beyond the reach of arm and hand.
_LEVER = 1.5


class Body(NamedTuple):
    """The arm with its hand.

    Attributes:
        chain: That of the `Arm`.
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

    chain: Array
    link: Indices
    ends: Array
    radius: Array
    pairs: Indices
    movers: Indices
    ball_link: Indices
    ball_center: Array
    ball_radius: Array
    guarded: Array


class ArmState(NamedTuple):
    """Poses of the links, and velocity bounds of the n joints.

    Attributes:
        chain: That of the `Arm`.
        R: Rotations of the link frames, shape (n + 1, 3, 3).
        p: Their origins, shape (n + 1, 3) [m].
        lower: Lower bounds of the joint velocities, shape (n,) [rad/s]; further entries are free.
        upper: Upper bounds.
    """

    chain: Array
    R: Array
    p: Array
    lower: Array
    upper: Array


class Obstacles(NamedTuple):
    """What arm and hand keep off: a scene and a moving object, see `MovingObject`.

    Attributes:
        grid: Distances of an `ObstacleGrid` of the scene; empty without one.
        frame: Its frame.
        object_grid: Those of the object, in its own frame; empty without one.
        object_frame: Its frame.
        X_WO: Pose of the object.
        V_WO: Its twist.
        extra_clearance: Within this distance beyond its clearance the hand comes nearer but slowly.
    """

    grid: Float32
    frame: Array
    object_grid: Float32
    object_frame: Array
    X_WO: Array
    V_WO: Array
    extra_clearance: float


class Request(NamedTuple):
    """What is asked of the QP, see `SafetyFilter.velocity`; empty arrays for what is not given."""

    q: Array
    qd_preferred: Array
    J: Array
    V: Array
    qd_last: Array


@compiled(forceinline=True)
def _keep(rows, bounds, m, bound, lower, upper):
    """Takes row m if some velocity between the bounds breaks it; returns how many rows there are.

    The next row is cleared.
    """
    row = rows[m]
    slowest, moves = 0.0, False
    for j in range(len(row)):
        slowest += min(row[j] * lower[j], row[j] * upper[j])
        moves = moves or abs(row[j]) > 1e-9
    bounds[m] = bound
    m += moves and slowest < bound
    rows[m] = 0.0
    return m


@compiled
def rows_kernel(arm, options, body, grid, frame, rows, bounds):
    """Writes rows (m, n) and their lower bounds (m,); returns m.

    ``options`` are `SafetyOptions` as a record, ``grid`` and ``frame`` those of an `ObstacleGrid`.
    """
    chain, R, p, lower, upper = arm
    link, radius, gain = body.link, body.radius, options.approach_gain
    placed = np.empty(body.ends.shape)
    for c in range(len(link)):
        for e in range(2):
            x, y, z = place(R, p, link[c], end_point(body.ends, c, e))
            placed[c, e, 0], placed[c, e, 1], placed[c, e, 2] = x, y, z
    # Nothing approaches faster than this, so what is farther than it allows needs no closer look.
    fastest = 0.0
    for j in range(len(chain) - 1):
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
        add_lever(chain, step(b0, t, minus(b1, b0)), normal, link[i], link[j], R, p, rows[m])
        m = _keep(rows, bounds, m, -gain * (distance - options.clearance), lower, upper)
    for k in range(len(body.movers)):
        c = body.movers[k]
        for e in range(2):
            distance = placed[c, e, 2] - radius[c] - options.table_height
            if distance > far:
                continue
            # Direction up in W. Source: definition.
            add_lever(chain, end_point(placed, c, e), (0.0, 0.0, 1.0), 0, link[c], R, p, rows[m])
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
        add_lever(chain, center, slope, 0, body.ball_link[k], R, p, rows[m])
        m = _keep(rows, bounds, m, -gain * (distance - options.obstacle_clearance), lower, upper)
    return m


@compiled
def object_rows_kernel(arm, options, guarded, obstacles, most, rows, bounds):
    """Writes rows (m, n) and bounds (m,) that keep arm and hand off a moving object; returns m.

    ``guarded`` holds what is kept off, one line of link, x, y, z and radius each: points of the
    hand (radius 0), which keep a small clearance, and balls that cover the arm, which keep the
    one to obstacles. Either may approach the surface at most at gain x what is left beyond the
    clearance, a slow hand at a larger one, relative to the surface as it moves: ``n . (v_point
    - v_surface)``; points of the hand that are no farther off than the ``extra_clearance`` a
    lot slower. Of more than ``most`` those are kept that ask for the greatest speed away from
    it.
    """
    chain, R, p, lower, upper = arm
    _, _, grid, frame, X_WO, V_WO, extra_clearance = obstacles
    if grid.size == 0 or not np.isfinite(X_WO.sum() + V_WO.sum()):
        return 0
    # Nothing approaches faster than this, so what is farther than it allows needs no closer look.
    fastest = math.sqrt(V_WO[3] ** 2 + V_WO[4] ** 2 + V_WO[5] ** 2)
    turning_rate = math.sqrt(V_WO[0] ** 2 + V_WO[1] ** 2 + V_WO[2] ** 2)
    for j in range(len(chain) - 1):
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
            # Share of the speed of approach that is left in the reserve. Were nothing left, or had
            # the hand to leave it, fingers on both sides of an object could get stuck.
            left = max(left - extra_clearance, min(left, 0.2 * left))
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
        add_lever(chain, x, normal, 0, link, R, p, rows[m])
        m = _keep(rows, bounds, m, dot(normal, surface) - allowed, lower, upper)
    if m > most:
        kept = np.sort(np.argsort(-bounds[:m])[:most])
        for i in range(most):
            rows[i], bounds[i] = rows[kept[i]], bounds[kept[i]]
        m = most
    return m


@compiled
def _write_request(qd_preferred, J, V, rotation_weight, damping, H, f):
    """Writes the quadratic objective, H (n, n) and f (n,); false if the request is not finite."""
    # Requests are cut to this, far beyond what the arm can do, so that no square overflows.
    largest_request = 1e3
    H[:] = 0.0
    weight = damping if len(V) > 0 else 1.0
    n = len(f)
    for i in range(n):
        wish = min(max(qd_preferred[i], -largest_request), largest_request)
        H[i, i] = weight
        f[i] = -weight * wish
    total = 0.0
    for r in range(len(V)):
        square = rotation_weight**2 if r < 3 else 1.0
        wish = min(max(V[r], -largest_request), largest_request)
        total += V[r]
        for i in range(n):
            scaled = square * J[r, i]
            f[i] -= scaled * wish
            for j in range(n):
                H[i, j] += scaled * J[r, j]
    for i in range(n):
        total += qd_preferred[i] + f[i]
        for j in range(n):
            total += H[i, j]
    return np.isfinite(total)


@compiled
def problem_kernel(request, options, body, obstacles, matrix, vector):
    """Writes the QP; returns the number of hard rows, -1 if the state is not finite, and of all.

    In two arrays, since making a NumPy array costs as much as filling it: ``matrix`` has H (n, n)
    and below it the rows (m, n), ``vector`` the lines lower bounds, upper bounds and f.
    """
    q, qd_preferred, J, V, qd_last = request
    settings, n = options[0], len(q)
    lower, upper, f = vector[0], vector[1], vector[2, :n]
    state = 0.0
    for i in range(n):
        state += q[i] + (qd_last[i] if len(qd_last) > 0 else 0.0)
    if not np.isfinite(state):
        return -1, -1
    bounds_kernel(body.chain, q, qd_last, settings, lower, upper)
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    link_poses_kernel(body.chain, q, R, p)
    arm = ArmState(body.chain, R, p, lower, upper)
    m = rows_kernel(arm, settings, body, obstacles.grid, obstacles.frame, matrix[n:], lower[n:])
    rows, bounds = matrix[n + m :], lower[n + m :]
    total = m + object_rows_kernel(
        arm, settings, body.guarded, obstacles, MOST_OBJECT_ROWS, rows, bounds
    )
    upper[n : n + total] = 1e30
    if not _write_request(
        qd_preferred, J, V, settings.rotation_weight, settings.damping, matrix[:n], f
    ):  # stand still
        matrix[:n] = np.eye(n)
        f[:] = 0.0
    return m, total


@compiled
def clip_kernel(qd, vector):
    """Rounds a solution into the joints' bounds; false if it is not finite."""
    total = 0.0
    for i in range(len(qd)):
        total += qd[i]
        qd[i] = min(max(qd[i], vector[0, i]), vector[1, i])
    return np.isfinite(total)
