"""What several tests compare with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.vectors import dot
from feasigrasp.models.robot.capsule_kernels import (
    closest_parameters,
    end_point,
    link_poses_kernel,
    place,
)
from feasigrasp.models.robot.capsules import CapsuleModel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.arm import IIWA_CAPSULES


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


def table_distances(
    q: ArrayLike, table_height: float = 0.0, model: CapsuleModel = IIWA_CAPSULES
) -> Array:
    """Clearance above a horizontal plane of the ends of the capsules whose height can change.

    Args:
        q: Joint positions, shape (7,) [rad].
        table_height: Height of the plane in the base frame [m].
        model: The capsules; each of ``model.movers`` has two entries in a row, one per end (links 2
            to 7 and the hand; the height of link 1 never changes).

    Returns:
        Shape (2 m,) [m], negative below the plane.

    Raises:
        ValueError: ``q`` does not have shape (7,).
    """
    ends = np.empty(model.ends.shape)
    capsule_ends_kernel(IIWA_7.positions(q, 1), model, ends)
    radius = model.radius[model.movers, None]
    return np.asarray((ends[model.movers, :, 2] - radius - table_height).reshape(-1))
