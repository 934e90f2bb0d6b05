"""Normals of a point cloud by local principal component analysis."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Indices

#: Below this |cosine| between a normal and its reference direction its sign is a guess.
_UNSURE = 0.15


def outward_normals(
    cloud: Array,
    indices: Indices,
    towards_camera: Array | None,
    neighbours: int = 20,
) -> tuple[Array, Array]:
    """Outward unit normals at some points of a cloud.

    A normal is turned to the camera's side, or, without a camera, away from the centroid. Where
    that cannot be told (normal nearly perpendicular to the reference) the point is left out:
    a normal with the wrong sign does more harm than none.

    Args:
        cloud: Points, shape (n, 3) [m].
        indices: Which of them get a normal, shape (m,).
        towards_camera: Direction from each of those points to its camera, shape (m, 3), or None.
        neighbours: Size of the neighbourhood that a plane is fitted to.

    Returns:
        Positions (k, 3) and normals (k, 3), k <= m.
    """
    at = cloud[indices]
    _, near = cKDTree(cloud).query(at, k=min(neighbours, len(cloud)))
    patch = cloud[near]
    patch = patch - patch.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("mki,mkj->mij", patch, patch))
    normals = vectors[:, :, 0]
    reference = at - cloud.mean(axis=0) if towards_camera is None else towards_camera
    length = np.maximum(np.linalg.norm(reference, axis=1), 1e-12)
    cosine = np.einsum("mi,mi->m", normals, reference) / length
    sure = np.abs(cosine) > _UNSURE
    return at[sure], (normals * np.sign(cosine)[:, None])[sure]
