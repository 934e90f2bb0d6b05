"""Learned estimate of the object's thickness behind the observed surface.

Nothing of an object lies outside its silhouette: where its surface ends along the line of sight of
every pixel, beside where it begins, gives the whole outer shape. A small network has learnt
how thick household shapes are behind each pixel; the distance field takes that for observations
that are as uncertain as the network says (`feasigrasp.models.shape.completion`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.view_image import SIDE, ViewImage
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.shape.gpdf import Gpdf

#: Half widths of pictures are given relative to this [m].
TYPICAL_SIZE = 0.1
#: Thickness that is looked for in the field, least and most [m].
LEAST, MOST = 4e-3, 0.4


@dataclass(frozen=True, eq=False)
class BackSurface:
    """Estimated far surface of an object behind the pixels of a view.

    Attributes:
        depth: Along z of the picture's camera, shape (SIDE, SIDE) [m]; 0 outside the silhouette.
        deviation: Expected error of the depth, shape (SIDE, SIDE) [m].
    """

    depth: Array
    deviation: Array


def picture_scale(image: ViewImage) -> float:
    """Half the width of the picture at the object's depth [m]: the unit of lengths in it."""
    return 0.5 * SIDE * image.pixel * float(image.depth[image.mask].mean())


def estimated_thickness(image: ViewImage, field: Gpdf) -> tuple[Array, Array]:
    """Depth of a field along the lines of sight, and its distance from observations.

    Every second line of sight of every second row is looked at, which is as fine as fields are.

    Returns:
        From the pictured surface to the end of the field, along z of the camera, and the distance
        of that end from the nearest observed point; shape (SIDE, SIDE) each [m]; NaN outside the
        silhouette and where there is no end.
    """
    coarse = image.mask[::2, ::2]
    rays = image.rays()[::2, ::2][coarse] @ image.X_OC[:3, :3].T
    length = np.linalg.norm(rays, axis=1)
    starts = image.X_OC[:3, 3] + image.depth[::2, ::2][coarse][:, None] * rays
    exits = field.ray_exits(starts, rays / length[:, None], MOST, LEAST) / length
    ends = starts + exits[:, None] * rays
    found = np.isfinite(exits)
    apart = np.full(len(exits), np.nan)
    apart[found] = nearest_distance(ends[found], field.points)
    answers = np.full((2, *coarse.shape), np.nan)
    answers[:, coarse] = exits, apart
    thickness, apart = np.where(image.mask, answers.repeat(2, axis=1).repeat(2, axis=2), np.nan)
    return thickness, apart


def features(image: ViewImage, field: Gpdf) -> NDArray[np.float32]:
    """Network input of a view, shape (FEATURES, SIDE, SIDE).

    Silhouette, depth relative to its mean, distance to the rim, the size of the object, the
    thickness of the field, where there is one, and how far its end is from the observed surface.
    """
    scale, mask = picture_scale(image), image.mask
    relative = np.where(mask, image.depth - image.depth[mask].mean(), 0.0) / scale
    rim = distance_transform_edt(mask) / (0.25 * SIDE)
    size = np.where(mask, np.log(scale / TYPICAL_SIZE), 0.0)
    estimated, apart = (part / scale for part in estimated_thickness(image, field))
    known = np.isfinite(estimated)
    estimated, apart = (np.where(known, part, 0.0) for part in (estimated, apart))
    return np.stack([mask, relative, rim, size, estimated, known, apart]).astype(np.float32)
