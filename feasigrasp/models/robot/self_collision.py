"""Distances between the arm's capsules and to a table; self-collision test.

The distance of two capsules is that of their segments minus both radii. The functions use the iiwa
with its hand unless they are given another model. The kernels that other compiled code calls are
in `feasigrasp.models.robot.capsule_kernels` and `feasigrasp.models.robot.collision_kernels`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.capsule_kernels import distances_kernel
from feasigrasp.models.robot.capsules import CapsuleModel, capsule_model
from feasigrasp.models.robot.collision_kernels import in_collision_batch_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

#: The arm with its hand: the model that the functions use by default.
IIWA_CAPSULES = capsule_model()


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
