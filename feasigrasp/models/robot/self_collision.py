"""Distances between the arm's capsules, and to a table, with gradients in the joint angles.

The distance of two capsules is that of their segments minus both radii. The functions use the iiwa
with its hand unless they are given another model. The kernels that other compiled code calls are
in `feasigrasp.models.robot.capsule_kernels` and `feasigrasp.models.robot.collision_kernels`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.robot.capsule_kernels import distances_kernel, gradients_kernel, table_kernel
from feasigrasp.models.robot.capsules import CapsuleModel, capsule_model
from feasigrasp.models.robot.collision_kernels import in_collision_batch_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

#: The arm with its hand: the model that the functions use by default.
IIWA_CAPSULES = capsule_model()


@njit(cache=True, nogil=True)
def _distances_batch(q, model, distance):
    for n in range(len(q)):
        distances_kernel(q[n], model, distance[n])


@njit(cache=True, nogil=True)
def _gradients_batch(q, model, distance, gradient):
    for n in range(len(q)):
        gradients_kernel(q[n], model, distance[n], gradient[n])


def _positions(q: ArrayLike, expected: str, ndim: int | None = None) -> Array:
    q = np.ascontiguousarray(q, dtype=float)
    if q.shape[-1] != IIWA_7.joints or ndim not in (None, q.ndim):
        raise ValueError(f"joint positions must have shape {expected}, got {q.shape}")
    return q


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
    q = _positions(q, "(..., 7)")
    pairs = len(model.pairs)
    distance = np.empty((*q.shape[:-1], pairs))
    _distances_batch(q.reshape(-1, IIWA_7.joints), model, distance.reshape(-1, pairs))
    return distance


def distances_and_gradients(
    q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES
) -> tuple[Array, Array]:
    """Signed distances (..., p) [m] and their gradients in the joint positions (..., p, 7) [m/rad].

    Where the segments of a pair cross, its gradient is zero. Arguments and errors as
    `signed_distances`.
    """
    q = _positions(q, "(..., 7)")
    pairs = len(model.pairs)
    distance = np.empty((*q.shape[:-1], pairs))
    gradient = np.empty((*q.shape[:-1], pairs, IIWA_7.joints))
    _gradients_batch(
        q.reshape(-1, IIWA_7.joints),
        model,
        distance.reshape(-1, pairs),
        gradient.reshape(-1, pairs, IIWA_7.joints),
    )
    return distance, gradient


def min_distance(q: ArrayLike, model: CapsuleModel = IIWA_CAPSULES) -> float:
    """The smallest signed distance of all checked pairs of one configuration (7,) [m]."""
    return float(signed_distances(_positions(q, "(7,)", 1), model).min())


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
    Q = _positions(Q, "(n, 7)", 2)
    hit = np.empty(len(Q), dtype=np.bool_)
    in_collision_batch_kernel(Q, model, float(margin), hit)
    return hit


def table_distances_and_gradients(
    q: ArrayLike, table_height: float = 0.0, model: CapsuleModel = IIWA_CAPSULES
) -> tuple[Array, Array]:
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
    q = _positions(q, "(7,)", 1)
    m = len(model.movers)
    clearance, gradient = np.empty((m, 2)), np.empty((m, 2, IIWA_7.joints))
    table_kernel(q, model, table_height, clearance, gradient)
    return clearance.reshape(-1), gradient.reshape(-1, IIWA_7.joints)
