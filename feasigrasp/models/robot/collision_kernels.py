"""Compiled self-collision tests: one configuration, or a SIMD batch.

Few configurations come close to a collision. First the balls about whole links are tested; only
where two of them meet the capsules are. For a batch the first test
runs on a block of configurations, its *lanes*, in loops that vectorise over them. The loops share
one flat array with constant offsets between its rows: that is what lets the compiler see that the
rows do not overlap.

A comparison with a NaN counts as contact: a configuration that is not known is not free.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.numerics.vectors import dot, minus, step
from feasigrasp.models.robot.capsule_kernels import (
    LINKS,
    closest_parameters,
    end_point,
    link_poses_kernel,
    place,
    walk_links,
)
from feasigrasp.models.robot.iiwa import IIWA_7

#: Configurations in a block: its rows stay in the first-level cache.
LANES = 64
# Rows: 7 angles that become sines, 7 cosines, 3 x 8 coordinates of the balls' centres.
_COSINES, _CENTRES = IIWA_7.joints, 2 * IIWA_7.joints
_ROWS = _CENTRES + 3 * LINKS


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
def _sincos_of(lane, joint):
    rows, stride, b = lane
    return rows[joint * stride + b], rows[(_COSINES + joint) * stride + b]


@compiled(forceinline=True)
def _write_centre(target, link, x, y, z, origin):
    (rows, stride, b), balls = target
    ball = balls[link]
    centre = step(step(step(origin, ball[0], x), ball[1], y), ball[2], z)
    for i in range(3):
        rows[(_CENTRES + 3 * link + i) * stride + b] = centre[i]


@compiled(forceinline=True)
def _write_centres(rows, stride, b, balls):
    """Writes the centres of the links' balls in lane b, from its sines and cosines."""
    lane = rows, stride, b
    walk_links(_sincos_of, lane, _write_centre, (lane, balls))


@compiled(forceinline=True)
def _ball(balls, k):
    return balls[k, 0], balls[k, 1], balls[k, 2]


@compiled(forceinline=True)
def _centres_of(balls):
    # As a tuple, which no loop changes, for the compiler.
    return (
        _ball(balls, 0), _ball(balls, 1), _ball(balls, 2), _ball(balls, 3),
        _ball(balls, 4), _ball(balls, 5), _ball(balls, 6), _ball(balls, 7),
    )  # fmt: skip


@compiled
def _write_one(q, rows, balls):
    """Writes the rows of a single configuration."""
    for j in range(IIWA_7.joints):
        rows[j], rows[_COSINES + j] = fast_sincos(q[j])
    _write_centres(rows, 1, 0, _centres_of(balls))


@compiled(forceinline=True)
def _balls_closer(rows, balls, groups, g, margin):
    """Whether the balls of a group's two links are closer than ``margin``, single configuration."""
    low, high = groups[g, 0], groups[g, 1]
    i, j = _CENTRES + 3 * low, _CENTRES + 3 * high
    x, y, z = rows[i] - rows[j], rows[i + 1] - rows[j + 1], rows[i + 2] - rows[j + 2]
    return _closer(x * x + y * y + z * z, balls[low, 3] + balls[high, 3] + margin)


@compiled
def doubts_kernel(q, balls, groups, margin, height, first, end):
    """Pairs undecided by the bounding balls of links: 0 if none.

    1 if links ``first`` to ``end - 1`` may reach below ``height``, 2 if pairs may be closer than
    ``margin``, 3 if both. Loops do best to take ``balls`` and ``groups`` out of the model before
    they begin: handing over a model counts references to all its arrays, as long as this takes.
    """
    rows, found = np.empty(_ROWS), 0
    _write_one(q, rows, balls)
    for link in range(first, end):
        if not rows[_CENTRES + 3 * link + 2] - balls[link, 3] >= height:
            found = 1
            break
    for g in range(len(groups)):
        if _balls_closer(rows, balls, groups, g, margin):
            return found + 2
    return found


@compiled
def _collides(q, model, margin):
    """Whether any pair is closer than ``margin``."""
    rows, R, p = np.empty(_ROWS), np.empty((LINKS, 3, 3)), np.empty((LINKS, 3))
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
def in_collision_kernel(q, model, margin):
    """Whether any pair is closer than ``margin`` [m]."""
    doubts = doubts_kernel(q, model.balls, model.groups, margin, 0.0, 0, 0)
    return doubts >= 2 and _collides(q, model, margin)


@compiled(forceinline=True)
def is_clear_kernel(q, model, clearance, height):
    """Whether all pairs are ``clearance`` [m] apart, and all movers above ``z = height``."""
    first, end = 0, 0
    if len(model.movers) > 0:  # in the order of their links
        first, end = model.link[model.movers[0]], model.link[model.movers[-1]] + 1
    doubts = doubts_kernel(q, model.balls, model.groups, clearance, height, first, end)
    if doubts & 1 and _reaches_below(q, model, height):
        return False
    return not (doubts >= 2 and _collides(q, model, clearance))


@compiled
def _load(Q, first, rows, doubt):
    """Writes sines and cosines of a block, and 0 (NaN for a bad configuration) to ``doubt``."""
    for b in range(LANES):
        q = Q[min(first + b, len(Q) - 1)]  # the last block is filled up
        doubt[b] = 0.0 * (q[0] + q[1] + q[2] + q[3] + q[4] + q[5] + q[6])
        for j in range(IIWA_7.joints):
            rows[j * LANES + b] = q[j]
    for i in range(IIWA_7.joints * LANES):
        rows[i], rows[i + _COSINES * LANES] = fast_sincos(rows[i])


@compiled
def _write_lanes(rows, balls):
    centres = _centres_of(balls)
    for b in range(LANES):
        _write_centres(rows, LANES, b, centres)


@compiled
def _test_lanes(rows, model, margin, doubt):
    """Adds to ``doubt`` how many pairs of links have balls that are closer than ``margin``."""
    for g in range(len(model.groups)):
        low, high = model.groups[g, 0], model.groups[g, 1]
        reach = max(model.balls[low, 3] + model.balls[high, 3] + margin, 0.0)
        i, j = (_CENTRES + 3 * low) * LANES, (_CENTRES + 3 * high) * LANES
        a, b = rows[i : i + 3 * LANES], rows[j : j + 3 * LANES]
        for k in range(LANES):
            x, y = a[k] - b[k], a[k + LANES] - b[k + LANES]
            z = a[k + 2 * LANES] - b[k + 2 * LANES]
            doubt[k] += 0.0 if x * x + y * y + z * z >= reach * reach else 1.0


@compiled(nogil=True)
def in_collision_batch_kernel(Q, model, margin, hit):
    """Writes whether configurations (n, 7) have a pair closer than ``margin`` [m]; True for NaN."""
    rows, doubt = np.empty(_ROWS * LANES), np.empty(LANES)
    for first in range(0, len(Q), LANES):
        _load(Q, first, rows, doubt)
        _write_lanes(rows, model.balls)
        _test_lanes(rows, model, margin, doubt)
        for b in range(min(LANES, len(Q) - first)):
            if np.isnan(doubt[b]):
                hit[first + b] = True
            elif doubt[b] == 0.0:
                hit[first + b] = False
            else:
                hit[first + b] = _collides(Q[first + b], model, margin)
