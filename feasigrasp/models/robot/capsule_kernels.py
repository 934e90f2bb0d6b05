"""Compiled geometry of the arm's capsules: link frames, distances of segments.

The kernels are scalar numba code that other kernels can call; each takes the arrays of a
`CapsuleModel` as an argument, so that no fact about the capsules is frozen into their compiled
cache. Link frames are rotations ``R`` (8, 3, 3) and origins ``p`` (8, 3) in the world.
"""

from __future__ import annotations

import math

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.numerics.vectors import cross, dot, minus, step, turn
from feasigrasp.models.robot.iiwa import IIWA_7

#: The base counts as one.
LINKS = IIWA_7.joints + 1
_H0, _H1 = IIWA_7.joint_heights[:2]
_L2, _L3, _L4, _L5, _L6 = IIWA_7.link_steps[2:7]
# Sign of a joint about y; 0 for a joint about z.
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
def capsule_ends_kernel(q, model, ends):
    """Writes the capsules' end points (c, 2, 3) in the world."""
    R, p = np.empty((LINKS, 3, 3)), np.empty((LINKS, 3))
    link_poses_kernel(q, R, p)
    for c in range(len(model.link)):
        for e in range(2):
            x, y, z = place(R, p, model.link[c], end_point(model.ends, c, e))
            ends[c, e, 0], ends[c, e, 1], ends[c, e, 2] = x, y, z


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


@compiled
def distances_kernel(q, model, distance):
    """Writes the signed distance of every pair (p,)."""
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, ends)
    for k in range(len(model.pairs)):
        i, j = model.pairs[k, 0], model.pairs[k, 1]
        a0, a1 = end_point(ends, i, 0), end_point(ends, i, 1)
        b0, b1 = end_point(ends, j, 0), end_point(ends, j, 1)
        _, _, d = closest_parameters(a0, a1, b0, b1)
        distance[k] = math.sqrt(dot(d, d)) - model.radius[i] - model.radius[j]
