"""Compiled geometry of the arm's capsules: link frames, distances of segments, collision tests.

Few configurations come close to a collision. First the balls about whole links are tested; only
where two of them meet the capsules are. A comparison with a NaN counts as contact: a configuration
that is not known is not free.

The kernels are scalar numba code that other kernels can call; each takes the arrays of a
`CapsuleModel` as an argument, so that no fact about the capsules is frozen into their compiled
cache. Link frames are rotations ``R`` (8, 3, 3) and origins ``p`` (8, 3) in the world.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.numerics.vectors import cross, dot, minus, step, turn
from feasigrasp.models.robot.iiwa import IIWA_7

#: The base counts as one. Source: layout.
LINKS = IIWA_7.joints + 1
_H0, _H1 = IIWA_7.joint_heights[:2]
_L2, _L3, _L4, _L5, _L6 = IIWA_7.link_steps[2:7]
#: Sign of a joint about y; 0 for a joint about z. Source: formula.
_Y_SIGN = np.ascontiguousarray(IIWA_7.joint_axes[:, 1])


@compiled(forceinline=True)
def walk_links(sincos, source, write, target):
    """Goes along the arm: ``write(target, k, x, y, z, origin)`` takes the frame of each link k.

    ``sincos(source, j)`` gives the sine and the cosine of joint j.
    """
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    write(target, 0, x, y, z, (0.0, 0.0, 0.0))
    s, c = sincos(source, 0)
    x, y = (c, s, 0.0), (-s, c, 0.0)
    write(target, 1, x, y, z, (0.0, 0.0, _H0))
    s, c = sincos(source, 1)
    z, x = turn(z, x, s, c)
    origin = (0.0, 0.0, _H1)
    write(target, 2, x, y, z, origin)
    origin = step(origin, _L2, z)
    s, c = sincos(source, 2)
    x, y = turn(x, y, s, c)
    write(target, 3, x, y, z, origin)
    origin = step(origin, _L3, z)
    s, c = sincos(source, 3)
    z, x = turn(z, x, -s, c)  # joint 4 turns about -y
    write(target, 4, x, y, z, origin)
    origin = step(origin, _L4, z)
    s, c = sincos(source, 4)
    x, y = turn(x, y, s, c)
    write(target, 5, x, y, z, origin)
    origin = step(origin, _L5, z)
    s, c = sincos(source, 5)
    z, x = turn(z, x, s, c)
    write(target, 6, x, y, z, origin)
    origin = step(origin, _L6, z)
    s, c = sincos(source, 6)
    x, y = turn(x, y, s, c)
    write(target, 7, x, y, z, origin)


@compiled(forceinline=True)
def _sincos_of(q, joint):
    return fast_sincos(q[joint])


@compiled(forceinline=True)
def _write_frame(target, k, x, y, z, origin):
    R, p = target
    for i in range(3):
        R[k, i, 0], R[k, i, 1], R[k, i, 2] = x[i], y[i], z[i]
        p[k, i] = origin[i]


@compiled
def link_poses_kernel(q, R, p):
    """Writes rotations (8, 3, 3) and origins (8, 3) of the link frames 0 to 7 in the world."""
    walk_links(_sincos_of, q, _write_frame, (R, p))


@compiled(forceinline=True)
def end_point(ends, c, e):
    """End point of a capsule."""
    return ends[c, e, 0], ends[c, e, 1], ends[c, e, 2]


@compiled(forceinline=True)
def place(R, p, k, a):
    """The point ``a`` of link k in the world."""
    return (
        R[k, 0, 0] * a[0] + R[k, 0, 1] * a[1] + R[k, 0, 2] * a[2] + p[k, 0],
        R[k, 1, 0] * a[0] + R[k, 1, 1] * a[1] + R[k, 1, 2] * a[2] + p[k, 1],
        R[k, 2, 0] * a[0] + R[k, 2, 1] * a[1] + R[k, 2, 2] * a[2] + p[k, 2],
    )


@compiled
def closest_parameters(a0, a1, b0, b1):
    """Closest points of two segments: fractions of their lengths, and the vector from b to a.

    Clamped solution of the 2x2 normal equations (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    u, v, w = minus(a1, a0), minus(b1, b0), minus(a0, b0)
    uu, vv, uv, uw, vw = dot(u, u), dot(v, v), dot(u, v), dot(u, w), dot(v, w)
    determinant = uu * vv - uv * uv
    s = 0.0
    if determinant > 1e-12 * uu * vv:
        s = min(max((uv * vw - uw * vv) / determinant, 0.0), 1.0)
    t = (uv * s + vw) / vv if vv > 0.0 else 0.0
    if t < 0.0:
        t = 0.0
        s = min(max(-uw / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    elif t > 1.0:
        t = 1.0
        s = min(max((uv - uw) / uu, 0.0), 1.0) if uu > 0.0 else 0.0
    return s, t, step(step(w, s, u), -t, v)


@compiled
def add_lever(point, normal, low, high, R, p, gradient):
    """Writes how joints low+1 to high move a point along a direction into ``gradient`` (7,)."""
    for j in range(low, high):
        # The joint's axis is a column of its link's rotation, which the joint leaves as it is.
        sign = _Y_SIGN[j]
        if sign == 0.0:
            axis = R[j + 1, 0, 2], R[j + 1, 1, 2], R[j + 1, 2, 2]
        else:
            axis = sign * R[j + 1, 0, 1], sign * R[j + 1, 1, 1], sign * R[j + 1, 2, 1]
        lever = point[0] - p[j + 1, 0], point[1] - p[j + 1, 1], point[2] - p[j + 1, 2]
        gradient[j] = dot(normal, cross(axis, lever))


#: Rows: 7 angles that become sines, 7 cosines, 3 x 8 coordinates of the balls' centres. Source:
#: layout.
COSINES, CENTRES = IIWA_7.joints, 2 * IIWA_7.joints
ROWS = CENTRES + 3 * LINKS


@compiled(forceinline=True)
def _closer(squared, distance):
    """Whether ``sqrt(squared) < distance``, without the root; True for NaN."""
    return not squared >= (distance * distance if distance > 0.0 else 0.0)


@compiled(forceinline=True)
def _segments_closer(a0, a1, b0, b1, reach, distance):
    """Whether segments are closer than ``distance``; not if their middles are not within reach."""
    apart = minus(step(a0, 1.0, a1), step(b0, 1.0, b1))  # twice the way between the middles
    if not _closer(dot(apart, apart), 2.0 * reach):
        return False
    _, _, d = closest_parameters(a0, a1, b0, b1)
    return _closer(dot(d, d), distance)


@compiled
def _group_collides(R, p, model, g, margin):
    """Whether any pair of a group is closer than ``margin``, from the link frames."""
    pairs, ends, reach, radius = model.pairs, model.ends, model.reach, model.radius
    low, high = model.groups[g, 0], model.groups[g, 1]
    for k in range(model.groups[g, 2], model.groups[g, 3]):
        i, j = pairs[k, 0], pairs[k, 1]
        a0, a1 = place(R, p, low, end_point(ends, i, 0)), place(R, p, low, end_point(ends, i, 1))
        b0, b1 = place(R, p, high, end_point(ends, j, 0)), place(R, p, high, end_point(ends, j, 1))
        if _segments_closer(
            a0, a1, b0, b1, reach[i] + reach[j] + margin, radius[i] + radius[j] + margin
        ):
            return True
    return False


@compiled(forceinline=True)
def _sincos_in_lane(lane, joint):
    rows, stride, b = lane
    return rows[joint * stride + b], rows[(COSINES + joint) * stride + b]


@compiled(forceinline=True)
def _write_centre(target, link, x, y, z, origin):
    (rows, stride, b), balls = target
    ball = balls[link]
    centre = step(step(step(origin, ball[0], x), ball[1], y), ball[2], z)
    for i in range(3):
        rows[(CENTRES + 3 * link + i) * stride + b] = centre[i]


@compiled(forceinline=True)
def write_centres(rows, stride, b, balls):
    """Writes the centres of the links' balls in lane b, from its sines and cosines."""
    lane = rows, stride, b
    walk_links(_sincos_in_lane, lane, _write_centre, (lane, balls))


@compiled(forceinline=True)
def _ball(balls, k):
    return balls[k, 0], balls[k, 1], balls[k, 2]


@compiled(forceinline=True)
def centres_of(balls):
    """Balls as a tuple, which no loop changes, for the compiler."""
    return (
        _ball(balls, 0), _ball(balls, 1), _ball(balls, 2), _ball(balls, 3),
        _ball(balls, 4), _ball(balls, 5), _ball(balls, 6), _ball(balls, 7),
    )  # fmt: skip


@compiled
def _write_one(q, rows, balls):
    """Writes the rows of a single configuration."""
    for j in range(IIWA_7.joints):
        rows[j], rows[COSINES + j] = fast_sincos(q[j])
    write_centres(rows, 1, 0, centres_of(balls))


@compiled(forceinline=True)
def _balls_closer(rows, balls, groups, g, margin):
    """Whether the balls of a group's two links are closer than ``margin``, single configuration."""
    low, high = groups[g, 0], groups[g, 1]
    i, j = CENTRES + 3 * low, CENTRES + 3 * high
    x, y, z = rows[i] - rows[j], rows[i + 1] - rows[j + 1], rows[i + 2] - rows[j + 2]
    return _closer(x * x + y * y + z * z, balls[low, 3] + balls[high, 3] + margin)


@compiled
def doubts_kernel(q, balls, groups, margin, height, first, end):
    """Pairs undecided by the bounding balls of links: 0 if none.

    1 if links ``first`` to ``end - 1`` may reach below ``height``, 2 if pairs may be closer than
    ``margin``, 3 if both. Loops do best to take ``balls`` and ``groups`` out of the model before
    they begin: handing over a model counts references to all its arrays, as long as this takes.
    """
    rows, found = np.empty(ROWS), 0
    _write_one(q, rows, balls)
    for link in range(first, end):
        if not rows[CENTRES + 3 * link + 2] - balls[link, 3] >= height:
            found = 1
            break
    for g in range(len(groups)):
        if _balls_closer(rows, balls, groups, g, margin):
            return found + 2
    return found


@compiled
def collides_kernel(q, model, margin):
    """Whether any pair is closer than ``margin``."""
    rows, R, p = np.empty(ROWS), np.empty((LINKS, 3, 3)), np.empty((LINKS, 3))
    _write_one(q, rows, model.balls)
    link_poses_kernel(q, R, p)
    for g in range(len(model.groups)):
        if _balls_closer(rows, model.balls, model.groups, g, margin) and _group_collides(
            R, p, model, g, margin
        ):
            return True
    return False


@compiled
def _reaches_below(q, model, height):
    """Whether a mover reaches below ``z = height``."""
    R, p = np.empty((LINKS, 3, 3)), np.empty((LINKS, 3))
    link_poses_kernel(q, R, p)
    for k in range(len(model.movers)):
        c = model.movers[k]
        link = model.link[c]
        z0 = place(R, p, link, end_point(model.ends, c, 0))[2]
        z1 = place(R, p, link, end_point(model.ends, c, 1))[2]
        if not min(z0, z1) - model.radius[c] >= height:
            return True
    return False


@compiled(forceinline=True)
def is_clear_kernel(q, model, clearance, height):
    """Whether all pairs are ``clearance`` [m] apart, and all movers above ``z = height``."""
    first, end = 0, 0
    if len(model.movers) > 0:  # in the order of their links
        first, end = model.link[model.movers[0]], model.link[model.movers[-1]] + 1
    doubts = doubts_kernel(q, model.balls, model.groups, clearance, height, first, end)
    if doubts & 1 and _reaches_below(q, model, height):
        return False
    return not (doubts >= 2 and collides_kernel(q, model, clearance))
