"""Dense sampling of the completed surface, for pictures."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.shape.gpdf import SurfacePoints
from feasigrasp.models.shape.gpdf_fit import Gpdf

#: Points of the first, uneven sample are projected from a grid of this many points per side.
_GRID = 16
#: Times that the sample grows by its neighbours.
_ROUNDS = 5
#: A point is on the surface if the raw distance is less [m].
_ON_SURFACE = 5e-4


def dense_surface(gpdf: Gpdf, across: int = 90) -> SurfacePoints:
    """Points of the completed surface, evenly spread, with normals and variance.

    `Gpdf.surface` projects a grid, which leaves holes where the field fans out. Here each of its
    points sends neighbours along its tangent plane, which are projected again, until the surface is
    covered.

    Args:
        gpdf: The field.
        across: Points along the longest side of the measured cloud.
    """
    spacing = float(np.ptp(gpdf.bounds, axis=0).max()) / across
    grown = gpdf.surface(_GRID)
    points, normals = _one_per_voxel(grown.points, grown.normals, spacing)
    for _ in range(_ROUNDS):
        tangents = perpendiculars(normals)
        beside = [points + spacing * sign * t for t in tangents for sign in (1.5, -1.5)]
        _, ends, end_normals = gpdf.refine(np.concatenate(beside), steps=4)
        kept = np.abs(gpdf.distance(ends)) < _ON_SURFACE
        points, normals = _one_per_voxel(
            np.concatenate([points, ends[kept]]),
            np.concatenate([normals, end_normals[kept]]),
            spacing,
        )
    return SurfacePoints(points, normals, gpdf.variance)


def _one_per_voxel(points: Array, normals: Array, size: float) -> tuple[Array, Array]:
    """The first point of every voxel, with its normal."""
    _, first = np.unique(np.floor(points / size).astype(np.int64), axis=0, return_index=True)
    return points[first], normals[first]
