"""Free space by silhouette carving: rays beside the silhouette and before the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import distance_transform_edt

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.view_image import MARGIN, SIDE, ViewImage
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.points import farthest_points

#: The points of a view miss the true edge by about this many pixels of the camera: edge pixels are
#: dropped, and so are pixels at a grazing angle.
EDGE_PIXELS = 1.0
#: Depths of the nodes behind the rim of the silhouette, as a share of the object's width.
RIM_DEPTHS = (0.0, 0.4)


def free_distance(views: Sequence[ViewImage], x: Array) -> Array:
    """Depth of points inside observed free space: a lower bound of their distance to the object.

    Beside the silhouette that is the distance to its rim, if it is whole, in front of the seen
    surface the depth to it; of several views the largest counts.

    Args:
        views: Views of the object.
        x: Points in O, shape (n, 3) [m].

    Returns:
        Shape (n,) [m]; zero or negative where nothing is known.
    """
    best = np.full(len(x), -np.inf)
    points = np.ascontiguousarray(x, dtype=float)
    for view in views:
        edge = EDGE_PIXELS * view.pitch
        picture = (view.mask, view.front, view.beside)
        _raise_to_free(points, view.X_OC, view.pixel, edge, view.whole, picture, best)
    return best


@compiled(nogil=True)
def _raise_to_free(points, X_OC, pixel, edge, whole, picture, best):
    """Raises ``best`` (n,) to how deep the points (n, 3) lie in the free space of one view."""
    mask, front, beside = picture
    for i in range(len(points)):
        a, b, c = points[i, 0] - X_OC[0, 3], points[i, 1] - X_OC[1, 3], points[i, 2] - X_OC[2, 3]
        u = a * X_OC[0, 0] + b * X_OC[1, 0] + c * X_OC[2, 0]
        v = a * X_OC[0, 1] + b * X_OC[1, 1] + c * X_OC[2, 1]
        w = a * X_OC[0, 2] + b * X_OC[1, 2] + c * X_OC[2, 2]
        z = max(w, 1e-6)
        u_at, v_at = u / z / pixel + 0.5 * (SIDE - 1), v / z / pixel + 0.5 * (SIDE - 1)
        column = int(min(max(np.rint(u_at), 0.0), SIDE - 1.0))
        row = int(min(max(np.rint(v_at), 0.0), SIDE - 1.0))
        if mask[row, column]:
            free = front[row, column] - z
        elif not whole:
            continue
        else:
            du, dv = u_at - column, v_at - row
            if max(abs(du), abs(dv)) > 0.5:  # outside the picture, which has a margin
                outside = np.sqrt(du * du + dv * dv) + MARGIN - 2.0
            else:
                outside = beside[row, column] - 0.5
            oblique = z / np.sqrt(u * u + v * v + w * w)
            free = (outside * pixel - edge) * z * oblique
        best[i] = max(best[i], free)


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
        Shape (n, 3) [m]; none where the silhouette is not whole.
    """
    if not view.whole:
        return np.zeros((0, 3))
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
