"""Distances between the arm's capsules, and to a table, with gradients in the joint angles.

The kernels are scalar numba code that other kernels can call; each takes the arrays of a
`CapsuleModel` as an argument, so that no fact about the arm is frozen into their compiled cache.
The public functions below them use the iiwa with its hand unless they are given another model.

The distance of two capsules is that of their segments minus both radii; with the witness points
``c1`` (lower link) and ``c2`` and ``n = (c2 - c1)/|c2 - c1|``, only joints between the two links
change it: ``dd/dq_j = n . (a_j x (c2 - p_j))`` with the joint's axis ``a_j`` through ``p_j``.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models.iiwa import JOINT_AXES, JOINT_HEIGHTS, NUM_JOINTS
from feasigrasp.models.iiwa_capsules import CapsuleModel, capsule_model

FloatArray = NDArray[np.float64]

#: The arm with its hand: the model that the functions use by default.
IIWA_CAPSULES = capsule_model()

_STEPS = np.diff(np.concatenate([[0.0], JOINT_HEIGHTS]))
# Sign of a joint about y; 0 for a joint about z.
_Y_SIGN = np.ascontiguousarray(JOINT_AXES[:, 1])


@njit(cache=True)
def link_poses_kernel(q, R, p):  # type: ignore[no-untyped-def]
    """Writes rotations (8, 3, 3) and origins (8, 3) of the link frames 0 to 7 in the world."""
    for i in range(3):
        for j in range(3):
            R[0, i, j] = 1.0 if i == j else 0.0
        p[0, i] = 0.0
    for k in range(NUM_JOINTS):
        s, c = math.sin(q[k]), math.cos(q[k])
        sign = _Y_SIGN[k]
        for i in range(3):
            x, y, z = R[k, i, 0], R[k, i, 1], R[k, i, 2]
            p[k + 1, i] = p[k, i] + z * _STEPS[k]
            if sign == 0.0:
                R[k + 1, i, 0] = c * x + s * y
                R[k + 1, i, 1] = c * y - s * x
                R[k + 1, i, 2] = z
            else:
                R[k + 1, i, 0] = c * x - sign * s * z
                R[k + 1, i, 1] = y
                R[k + 1, i, 2] = c * z + sign * s * x


@njit(cache=True)
def capsule_ends_kernel(q, model, R, p, ends):  # type: ignore[no-untyped-def]
    """Writes the link poses and the capsules' end points (c, 2, 3) in the world."""
    link_poses_kernel(q, R, p)
    for c in range(len(model.link)):
        k = model.link[c]
        for e in range(2):
            x, y, z = model.ends[c, e, 0], model.ends[c, e, 1], model.ends[c, e, 2]
            for i in range(3):
                ends[c, e, i] = R[k, i, 0] * x + R[k, i, 1] * y + R[k, i, 2] * z + p[k, i]


@njit(cache=True)
def closest_parameters(a, b):  # type: ignore[no-untyped-def]
    """Where two segments (2, 3) are closest: fractions of their lengths, and the distance.

    Clamped solution of the 2x2 normal equations (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    ux, uy, uz = a[1, 0] - a[0, 0], a[1, 1] - a[0, 1], a[1, 2] - a[0, 2]
    vx, vy, vz = b[1, 0] - b[0, 0], b[1, 1] - b[0, 1], b[1, 2] - b[0, 2]
    wx, wy, wz = a[0, 0] - b[0, 0], a[0, 1] - b[0, 1], a[0, 2] - b[0, 2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
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
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return s, t, math.sqrt(dx * dx + dy * dy + dz * dz)


@njit(cache=True)
def _add_lever(point, normal, low, high, R, p, gradient):  # type: ignore[no-untyped-def]
    """Writes how joints low+1 to high move a point along a direction into ``gradient`` (7,)."""
    nx, ny, nz = normal
    for j in range(low, high):
        # The joint's axis is a column of its link's rotation, which the joint leaves as it is.
        sign = _Y_SIGN[j]
        if sign == 0.0:
            ax, ay, az = R[j + 1, 0, 2], R[j + 1, 1, 2], R[j + 1, 2, 2]
        else:
            ax, ay, az = sign * R[j + 1, 0, 1], sign * R[j + 1, 1, 1], sign * R[j + 1, 2, 1]
        rx, ry, rz = point[0] - p[j + 1, 0], point[1] - p[j + 1, 1], point[2] - p[j + 1, 2]
        gradient[j] = nx * (ay * rz - az * ry) + ny * (az * rx - ax * rz) + nz * (ax * ry - ay * rx)


@njit(cache=True)
def distances_kernel(q, model, distance):  # type: ignore[no-untyped-def]
    """Writes the signed distance of every pair (p,)."""
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, R, p, ends)
    for k in range(len(model.pairs)):
        i, j = model.pairs[k]
        _, _, d = closest_parameters(ends[i], ends[j])
        distance[k] = d - model.radius[i] - model.radius[j]


@njit(cache=True)
def gradients_kernel(q, model, distance, gradient):  # type: ignore[no-untyped-def]
    """Writes signed distances (p,) and their gradients in q (p, 7)."""
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, R, p, ends)
    gradient[:] = 0.0
    c2 = np.empty(3)
    for k in range(len(model.pairs)):
        i, j = model.pairs[k]
        s, t, d = closest_parameters(ends[i], ends[j])
        distance[k] = d - model.radius[i] - model.radius[j]
        if d < 1e-9:  # crossing segments: every direction separates them, none is a gradient
            continue
        for x in range(3):
            c2[x] = ends[j, 0, x] + t * (ends[j, 1, x] - ends[j, 0, x])
        nx = (c2[0] - ends[i, 0, 0] - s * (ends[i, 1, 0] - ends[i, 0, 0])) / d
        ny = (c2[1] - ends[i, 0, 1] - s * (ends[i, 1, 1] - ends[i, 0, 1])) / d
        nz = (c2[2] - ends[i, 0, 2] - s * (ends[i, 1, 2] - ends[i, 0, 2])) / d
        low, high = model.link[i], model.link[j]
        _add_lever(c2, (nx, ny, nz), low, high, R, p, gradient[k])


@njit(cache=True)
def in_collision_kernel(q, model, margin):  # type: ignore[no-untyped-def]
    """Whether any pair is closer than ``margin`` [m]."""
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, R, p, ends)
    return ends_collide_kernel(ends, model, margin)


@njit(cache=True)
def ends_collide_kernel(ends, model, margin):  # type: ignore[no-untyped-def]
    """Whether any pair is closer than ``margin`` [m], from the capsules' end points (c, 2, 3)."""
    for k in range(len(model.pairs)):
        i, j = model.pairs[k]
        apart = 0.0  # square of twice the distance of the segments' middles
        for x in range(3):
            step = ends[i, 0, x] + ends[i, 1, x] - ends[j, 0, x] - ends[j, 1, x]
            apart += step * step
        reach = 2 * (model.reach[i] + model.reach[j] + margin)
        if apart > reach * reach and reach > 0.0:
            continue
        _, _, d = closest_parameters(ends[i], ends[j])
        if d < model.radius[i] + model.radius[j] + margin:
            return True
    return False


@njit(cache=True)
def table_kernel(q, model, height, clearance, gradient):  # type: ignore[no-untyped-def]
    """Writes clearances above ``z = height`` (m, 2) of the movers' ends; their gradients (m, 2, 7).

    Both ends, since of a level capsule either is the lower one after the next motion.
    """
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(q, model, R, p, ends)
    gradient[:] = 0.0
    for k in range(len(model.movers)):
        c = model.movers[k]
        for e in range(2):
            clearance[k, e] = ends[c, e, 2] - model.radius[c] - height
            _add_lever(ends[c, e], (0.0, 0.0, 1.0), 0, model.link[c], R, p, gradient[k, e])


@njit(cache=True)
def _in_collision_batch(Q, model, margin, hit):  # type: ignore[no-untyped-def]
    for n in range(len(Q)):
        hit[n] = in_collision_kernel(Q[n], model, margin)


def _positions(q: ArrayLike, ndim: int) -> FloatArray:
    q = np.ascontiguousarray(q, dtype=float)
    if q.ndim != ndim or q.shape[-1] != NUM_JOINTS:
        expected = "(7,)" if ndim == 1 else "(n, 7)"
        raise ValueError(f"joint positions must have shape {expected}, got {q.shape}")
    return q


def signed_distances(q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES) -> FloatArray:
    """Signed distance of every checked pair of capsules.

    Args:
        q: Joint positions, shape (7,) [rad].
        model: The capsules; ``model.pairs`` says which pair each entry belongs to.

    Returns:
        Shape (p,) [m]; negative where two capsules penetrate. NaN positions give NaN.

    Raises:
        ValueError: ``q`` does not have shape (7,).
    """
    distance = np.empty(len(model.pairs))
    distances_kernel(_positions(q, 1), model, distance)
    return distance


def distances_and_gradients(
    q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES
) -> tuple[FloatArray, FloatArray]:
    """Signed distances (p,) [m] and their gradients in the joint positions (p, 7) [m/rad].

    Where the segments of a pair cross, its gradient is zero. Arguments as `signed_distances`.
    """
    distance, gradient = np.empty(len(model.pairs)), np.empty((len(model.pairs), NUM_JOINTS))
    gradients_kernel(_positions(q, 1), model, distance, gradient)
    return distance, gradient


def min_distance(q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES) -> float:
    """The smallest signed distance of all checked pairs [m]. Arguments as `signed_distances`."""
    return float(signed_distances(q, model).min())


def in_collision(
    Q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Whether configurations are in self-collision.

    Args:
        Q: Joint positions, shape (n, 7) [rad].
        model: The capsules.
        margin: Pairs closer than this count as touching [m].

    Returns:
        Shape (n,); True for a configuration with NaN, which is not free either.

    Raises:
        ValueError: ``Q`` does not have shape (n, 7).
    """
    Q = _positions(Q, 2)
    hit = np.empty(len(Q), dtype=np.bool_)
    _in_collision_batch(Q, model, margin, hit)
    return hit | ~np.isfinite(Q).all(axis=1)


def table_distances_and_gradients(
    q: ArrayLike, table_height: float = 0.0, model: CapsuleModel = IIWA_CAPSULES
) -> tuple[FloatArray, FloatArray]:
    """Clearance above a horizontal plane of the ends of the capsules whose height can change.

    Args:
        q: Joint positions, shape (7,) [rad].
        table_height: Height of the plane in the base frame [m].
        model: The capsules; each of ``model.movers`` has two entries in a row, one per end (links 2
            to 7 and the hand; the height of link 1 never changes).

    Returns:
        Clearances (2 m,) [m], negative below the plane, and gradients (2 m, 7) [m/rad].

    Raises:
        ValueError: ``q`` does not have shape (7,).
    """
    m = len(model.movers)
    clearance, gradient = np.empty((m, 2)), np.empty((m, 2, NUM_JOINTS))
    table_kernel(_positions(q, 1), model, table_height, clearance, gradient)
    return clearance.reshape(-1), gradient.reshape(-1, NUM_JOINTS)
