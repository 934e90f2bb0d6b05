"""The plane that holds most points of a cloud, by random sample consensus (Fischler 1981)."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array

#: Points that planes are compared by; the share of a plane is then known to 1 % (one sigma).
_COMPARED = 2500


def largest_plane(points: Array, thickness: float, draws: int, seed: int = 0) -> Array:
    """The plane with the most points within ``thickness``, fitted to these by least squares.

    Args:
        points: Shape (n, 3), n > 0 [m].
        thickness: Largest distance of its points [m].
        draws: Planes through three random points that are tried.
        seed: Of the draws.

    Returns:
        Unit normal and offset: ``n . x + d`` is the signed distance of x [m], shape (4,).
    """
    rng = np.random.default_rng(seed)
    some = rng.permutation(points)[:_COMPARED]
    a, b, c = points[rng.integers(len(points), size=(3, draws))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.where(length > 0.0, length, 1.0)[:, None]
    offsets = -np.einsum("ni,ni->n", normals, a)
    count = (np.abs(some @ normals.T + offsets) <= thickness).sum(axis=0)
    best = int(np.argmax(np.where(length > 0.0, count, 0)))  # not of three points on a line
    near = points[np.abs(points @ normals[best] + offsets[best]) <= thickness]
    middle = near.mean(axis=0)
    normal = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
    return np.append(normal, -normal @ middle)
