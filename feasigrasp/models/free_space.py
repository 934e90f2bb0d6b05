"""Space that the camera has looked through: beside the silhouette and before the seen surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from feasigrasp.models.farthest_points import farthest_points
from feasigrasp.models.view_image import MARGIN, SIDE, ViewImage

Array = NDArray[np.float64]

#: The points of a view miss the true edge by about this many pixels of the camera: edge pixels are
#: dropped, and so is what is seen at a grazing angle.
EDGE_PIXELS = 1.0
#: Depths of the nodes behind the rim of the silhouette, as a share of the object's width.
RIM_DEPTHS = (0.0, 0.4)


def free_distance(views: Sequence[ViewImage], x: Array) -> Array:
    """How deep points lie in space known to be free: a lower bound of their distance to the object.

    Beside the silhouette that is the distance to its rim, in front of the seen surface the depth
    to it; of several views the largest counts.

    Args:
        views: Views of the object.
        x: Points in O, shape (n, 3) [m].

    Returns:
        Shape (n,) [m]; zero or negative where nothing is known.
    """
    best = np.full(len(x), -np.inf)
    for view in views:
        in_camera = view.in_camera(x)
        z = np.maximum(in_camera[:, 2], 1e-6)
        at = in_camera[:, :2] / z[:, None] / view.pixel + 0.5 * (SIDE - 1)
        index = np.clip(np.rint(at), 0, SIDE - 1).astype(int)
        column, row = index.T
        # Outside the picture, which has a margin round the silhouette.
        beyond = np.linalg.norm(at - index, axis=1)
        outside = np.where(
            np.abs(at - index).max(axis=1) > 0.5,
            beyond + MARGIN - 2.0,
            view.beside[row, column] - 0.5,
        )
        oblique = z / np.linalg.norm(in_camera, axis=1)
        beside = (outside * view.pixel - EDGE_PIXELS * view.pitch) * z * oblique
        before = view.depth[row, column] - z
        best = np.maximum(best, np.where(view.mask[row, column], before, beside))
    return best


def rim_points(view: ViewImage, count: int) -> Array:
    """Points in free space just outside a silhouette, where the object's hidden side begins.

    They lie on lines of sight spread evenly round the silhouette, at the depth of its rim and a
    part of the object's width behind it: there a surface that bulges out of the silhouette would
    be. Further back the distance to the silhouette says little about that to the object, and
    holding it there as a value makes the field invent.

    Args:
        view: The view.
        count: Number of points, at most.

    Returns:
        Shape (n, 3) [m].
    """
    at = EDGE_PIXELS * view.pitch / view.pixel + 1.5
    row, column = np.nonzero((view.beside >= at) & (view.beside < at + 1.0))
    if len(row) == 0:
        return np.zeros((0, 3))
    ring = np.stack([row, column, np.zeros_like(row)], axis=1).astype(float)
    chosen = farthest_points(ring, min(max(count // len(RIM_DEPTHS), 1), len(ring)))
    pixels = row[chosen], column[chosen]
    nearest_row, nearest_column = view.nearest[:, *pixels]
    rim = view.depth[nearest_row, nearest_column]
    half_width = float(distance_transform_edt(view.mask).max()) * view.pixel * rim.mean()
    return np.concatenate(
        [view.unproject(pixels, rim + 2.0 * share * half_width) for share in RIM_DEPTHS]
    )
