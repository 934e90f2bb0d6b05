"""Merging of views in the object frame: a turning object completes its own cloud."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class FusedCloud:
    """Surface points seen so far, one per voxel, with the direction they were seen from.

    Attributes:
        points: In the object frame O, shape (n, 3) [m].
        directions: Unit directions from each point to the camera, in O, shape (n, 3).
        voxel_size: Edge length of a voxel [m].
        views: Number of views merged.
    """

    points: FloatArray
    directions: FloatArray
    voxel_size: float
    views: int = 0

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("points", "directions"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __deepcopy__(self, memo: dict[int, Any]) -> FusedCloud:
        """Immutable, so a copy is itself."""
        return self

    @classmethod
    def empty(cls, voxel_size: float) -> FusedCloud:
        """Nothing seen yet."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), voxel_size)

    def merged(self, points: ArrayLike, p_OC: ArrayLike) -> FusedCloud:
        """Adds one view.

        Args:
            points: Surface points in O, shape (m, 3) [m].
            p_OC: Position of the camera in O, shape (3,) [m].

        Returns:
            The cloud with the mean of old and new points in every voxel.
        """
        points = np.asarray(points, dtype=float)
        to_camera = np.asarray(p_OC, dtype=float) - points
        to_camera /= np.maximum(np.linalg.norm(to_camera, axis=1, keepdims=True), 1e-12)
        # One mean point per voxel and view first, so that a view of many pixels weighs no more.
        new = _voxel_means(np.hstack([points, to_camera]), self.voxel_size)
        both = _voxel_means(
            np.vstack([np.hstack([self.points, self.directions]), new]), self.voxel_size
        )
        norm = np.maximum(np.linalg.norm(both[:, 3:], axis=1, keepdims=True), 1e-12)
        return FusedCloud(
            np.ascontiguousarray(both[:, :3]), both[:, 3:] / norm, self.voxel_size, self.views + 1
        )


def _voxel_means(rows: FloatArray, voxel_size: float) -> FloatArray:
    """Mean of the rows that share a voxel (by their first three columns), ordered by voxel."""
    if len(rows) == 0:
        return rows
    voxels = np.floor(rows[:, :3] / voxel_size).astype(np.int64)
    voxels -= voxels.min(axis=0)
    extent = voxels.max(axis=0) + 1
    keys = (voxels[:, 0] * extent[1] + voxels[:, 1]) * extent[2] + voxels[:, 2]
    _, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    columns = [np.bincount(inverse, weights=column) for column in rows.T]
    return np.stack(columns, axis=1) / counts[:, None]
