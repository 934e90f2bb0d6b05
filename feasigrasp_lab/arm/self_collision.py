"""Distances between the arm's capsules and to a table; self-collision test.

The distance of two capsules is that of their segments minus both radii. The functions use the iiwa
with its hand unless they are given another model. The kernels that runs call are in
`feasigrasp.models.robot.capsule_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import dot
from feasigrasp.models.robot.capsule_kernels import (
    closest_parameters,
    collides_kernel,
    doubts_kernel,
    end_point,
    link_poses_kernel,
    place,
)
from feasigrasp.models.robot.capsules import CapsuleModel, capsule_model
from feasigrasp.models.robot.iiwa import IIWA_7

#: The arm with its hand: the model that the functions use by default.
IIWA_CAPSULES = capsule_model()


@compiled
def capsule_ends_kernel(q, model, ends):
    """Writes the capsules' end points (c, 2, 3) in the world."""
    n = len(model.balls)
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    link_poses_kernel(model.chain, q, R, p)
    for c in range(len(model.link)):
        for e in range(2):
            x, y, z = place(R, p, model.link[c], end_point(model.ends, c, e))
            ends[c, e, 0], ends[c, e, 1], ends[c, e, 2] = x, y, z


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


@compiled(forceinline=True)
def in_collision_kernel(q, model, margin):
    """Whether any pair is closer than ``margin`` [m]."""
    doubts = doubts_kernel(model.chain, q, model.balls, model.groups, margin, 0.0, 0, 0)
    return doubts >= 2 and collides_kernel(q, model, margin)


@compiled(nogil=True)
def in_collision_batch_kernel(Q, model, margin, hit):
    """Writes whether configurations (n, 7) have a pair closer than ``margin`` [m]; True for NaN."""
    for k in range(len(Q)):
        hit[k] = in_collision_kernel(Q[k], model, margin)


@compiled(nogil=True)
def _distances_batch(q, model, distance):
    for n in range(len(q)):
        distances_kernel(q[n], model, distance[n])


def signed_distances(q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES) -> Array:
    """Signed distance of every checked pair of capsules.

    Args:
        q: Joint positions, shape (..., 7) [rad].
        model: The capsules; ``model.pairs`` says which pair each entry belongs to.

    Returns:
        Shape (..., p) [m]; negative where two capsules penetrate. NaN positions give NaN.

    Raises:
        ValueError: The last axis of ``q`` is not 7 long.
    """
    q = IIWA_7.positions(q)
    distance = np.empty((*q.shape[:-1], len(model.pairs)))
    _distances_batch(q.reshape(-1, IIWA_7.joints), model, distance.reshape(-1, distance.shape[-1]))
    return distance


def min_distance(q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES) -> float:
    """The smallest signed distance of all checked pairs of one configuration (7,) [m]."""
    return float(signed_distances(IIWA_7.positions(q, 1), model).min())


def in_collision(Q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES, margin: float = 0.0) -> Mask:
    """Whether configurations are in self-collision.

    Args:
        Q: Joint positions, shape (n, 7) [rad], at most 1e6 in size.
        model: The capsules.
        margin: Pairs closer than this count as touching [m].

    Returns:
        Shape (n,); True for a configuration with NaN, which is not free either.

    Raises:
        ValueError: ``Q`` does not have shape (n, 7).
    """
    Q = IIWA_7.positions(Q, 2)
    hit = np.empty(len(Q), dtype=np.bool_)
    in_collision_batch_kernel(Q, model, float(margin), hit)
    return hit
