"""Compiled geometry of the arm's capsules: link frames, distances of segments, collision tests.

Few configurations come close to a collision. First the balls about whole links are tested; only
where two of them meet the capsules are. A comparison with a NaN counts as contact: a configuration
that is not known is not free.

The kernels are scalar numba code that other kernels can call; each takes the arrays of a
`CapsuleModel` as an argument, so that no fact about the capsules is frozen into their compiled
cache. Link frames are rotations ``R`` (n + 1, 3, 3) and origins ``p`` (n + 1, 3) in the world, the
base's first; ``chain`` is that of an `Arm`.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.numerics.vectors import cross, dot, minus, step, turn, turn_frame
from feasigrasp.models.robot.arm import AXIS, DIRECTION, OFFSET, SIGN


@compiled(forceinline=True)
def next_origin(chain, j, origin, x, y, z):
    """The origin of the frame after the one with the axes x, y, z, by row j of the chain."""
    origin = step(step(origin, chain[j, OFFSET], x), chain[j, OFFSET + 1], y)
    return step(origin, chain[j, OFFSET + 2], z)


@compiled(forceinline=True)
def next_link(chain, j, angle, origin, x, y, z):
    """Origin and axes of link j + 1 by those of link j, and the direction that they turn about.

    That is the joint's axis but for `SIGN`.
    """
    origin = next_origin(chain, j, origin, x, y, z)
    s, c = fast_sincos(angle)
    s *= chain[j, SIGN]
    if chain[j, AXIS] == 2.0:
        axis = z
        x, y = turn(x, y, s, c)
    elif chain[j, AXIS] == 1.0:
        axis = y
        z, x = turn(z, x, s, c)
    elif chain[j, AXIS] == 0.0:
        axis = x
        y, z = turn(y, z, s, c)
    else:
        h = chain[j, DIRECTION], chain[j, DIRECTION + 1], chain[j, DIRECTION + 2]
        axis = step(step(step((0.0, 0.0, 0.0), h[0], x), h[1], y), h[2], z)
        x, y, z = turn_frame(x, y, z, h, s, c)
    return origin, x, y, z, axis


@compiled(forceinline=True)
def walk_links(chain, q, write, target):
    """Goes along the arm: ``write(target, k, x, y, z, origin)`` takes the frame of each link k."""
    x, y, z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    origin = (0.0, 0.0, 0.0)
    write(target, 0, x, y, z, origin)
    for j in range(len(chain) - 1):
        origin, x, y, z, _ = next_link(chain, j, q[j], origin, x, y, z)
        write(target, j + 1, x, y, z, origin)


@compiled(forceinline=True)
def _write_frame(target, k, x, y, z, origin):
    R, p = target
    for i in range(3):
        R[k, i, 0], R[k, i, 1], R[k, i, 2] = x[i], y[i], z[i]
        p[k, i] = origin[i]


@compiled
def link_poses_kernel(chain, q, R, p):
    """Writes rotations (n + 1, 3, 3) and origins (n + 1, 3) of the link frames in the world."""
    walk_links(chain, q, _write_frame, (R, p))


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
def add_lever(chain, point, normal, low, high, R, p, gradient):
    """Writes how joints low+1 to high move a point along a direction into ``gradient`` (n,)."""
    for j in range(low, high):
        # The joint's axis is a column of its link's rotation, which the joint leaves as it is.
        k, sign = int(chain[j, AXIS]), chain[j, SIGN]
        if k < 3:
            axis = sign * R[j + 1, 0, k], sign * R[j + 1, 1, k], sign * R[j + 1, 2, k]
        else:
            h = chain[j, DIRECTION], chain[j, DIRECTION + 1], chain[j, DIRECTION + 2]
            axis = minus(place(R, p, j + 1, h), (p[j + 1, 0], p[j + 1, 1], p[j + 1, 2]))
        lever = point[0] - p[j + 1, 0], point[1] - p[j + 1, 1], point[2] - p[j + 1, 2]
        gradient[j] = dot(normal, cross(axis, lever))


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
def _write_centre(target, link, x, y, z, origin):
    centres, balls = target
    centre = step(step(origin, balls[link, 0], x), balls[link, 1], y)
    centre = step(centre, balls[link, 2], z)
    centres[link, 0], centres[link, 1], centres[link, 2] = centre


@compiled
def _centres(chain, q, balls):
    """Centres of the links' balls in the world, shape (n + 1, 3)."""
    centres = np.empty((len(chain), 3))
    walk_links(chain, q, _write_centre, (centres, balls))
    return centres


@compiled(forceinline=True)
def _balls_closer(centres, balls, groups, g, margin):
    """Whether the balls of a group's two links are closer than ``margin``."""
    i, j = groups[g, 0], groups[g, 1]
    x, y = centres[i, 0] - centres[j, 0], centres[i, 1] - centres[j, 1]
    z = centres[i, 2] - centres[j, 2]
    return _closer(x * x + y * y + z * z, balls[i, 3] + balls[j, 3] + margin)


@compiled
def doubts_kernel(chain, q, balls, groups, margin, height, first, end):
    """Pairs undecided by the bounding balls of links: 0 if none.

    1 if links ``first`` to ``end - 1`` may reach below ``height``, 2 if pairs may be closer than
    ``margin``, 3 if both. Loops do best to take the arrays out of the model before they begin:
    handing over a model counts references to all its arrays, as long as this takes.
    """
    centres, found = _centres(chain, q, balls), 0
    for link in range(first, end):
        if not centres[link, 2] - balls[link, 3] >= height:
            found = 1
            break
    for g in range(len(groups)):
        if _balls_closer(centres, balls, groups, g, margin):
            return found + 2
    return found


@compiled
def collides_kernel(q, model, margin):
    """Whether any pair is closer than ``margin``."""
    n = len(model.balls)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    centres = _centres(model.chain, q, model.balls)
    link_poses_kernel(model.chain, q, R, p)
    for g in range(len(model.groups)):
        if _balls_closer(centres, model.balls, model.groups, g, margin) and _group_collides(
            R, p, model, g, margin
        ):
            return True
    return False


@compiled
def _reaches_below(q, model, height):
    """Whether a mover reaches below ``z = height``."""
    n = len(model.balls)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    link_poses_kernel(model.chain, q, R, p)
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
    doubts = doubts_kernel(model.chain, q, model.balls, model.groups, clearance, height, first, end)
    if doubts & 1 and _reaches_below(q, model, height):
        return False
    return not (doubts >= 2 and collides_kernel(q, model, clearance))
