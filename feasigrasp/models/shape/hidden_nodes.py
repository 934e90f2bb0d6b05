"""Nodes of the distance field on the side of an object that nobody has seen, as far as it is known.

`hidden_side` tells where the object probably ends behind each picture. Other pictures contradict
that where they look through the place, or see a surface in front of it that is not the far one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.free_space import free_distance
from feasigrasp.models.clouds.view_image import ViewImage
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.hidden_side import BackSurface
from feasigrasp.models.shape.hidden_side_network import HiddenSide

#: Nodes closer to an observed point than this know nothing that it does not [m], nor do those
#: closer than so many times their expected error. Where several pictures look round the object,
#: they more often see such places themselves than that these are the far side of something thin.
CLEARANCE, DOUBT = 3e-3, 1.0
CLEARANCE_OF_SEVERAL, DOUBT_OF_SEVERAL = 10e-3, 1.5
#: Nodes deeper in the free space of a picture than this are impossible [m].
_FREE = 2e-3


class HiddenNodes(NamedTuple):
    """Points where the hidden surface probably is.

    Attributes:
        points: Shape (n, 3) [m].
        deviation: Expected error along the line of sight, shape (n,) [m].
    """

    points: Array
    deviation: Array


def hidden_nodes(
    field: Gpdf, images: Sequence[ViewImage], observed: Array, network: HiddenSide, count: int
) -> HiddenNodes:
    """Nodes on the far sides of all pictures.

    Args:
        field: What is believed without the network.
        images: Pictures of the object, in the frame of the points; at least one.
        observed: Points seen, shape (n, 3) [m].
        network: Tells far sides.
        count: Number of nodes, at most.
    """
    backs = network.back_surfaces(images, field)
    parts = [_of_picture(image, back) for image, back in zip(images, backs, strict=True)]
    points, deviation = (np.concatenate(part) for part in zip(*parts, strict=True))
    several = len(images) > 1
    clearance = CLEARANCE_OF_SEVERAL if several else CLEARANCE
    doubt = DOUBT_OF_SEVERAL if several else DOUBT
    kept = free_distance(images, points) < _FREE
    for image, back in zip(images, backs, strict=True):
        kept &= ~_inside(image, back, points)
    points, deviation = points[kept], deviation[kept]
    kept = cKDTree(observed).query(points)[0] > np.maximum(clearance, doubt * deviation)
    points, deviation = points[kept], deviation[kept]
    if len(points) == 0:
        return HiddenNodes(points, deviation)
    chosen = farthest_points(points, min(count, len(points)))
    return HiddenNodes(points[chosen], deviation[chosen])


def _of_picture(image: ViewImage, back: BackSurface) -> tuple[Array, Array]:
    """Far points of the pixels whose four neighbours show the object too, and their deviations."""
    mask = binary_erosion(image.mask)
    rows, columns = np.nonzero(mask)
    return image.unproject((rows, columns), back.depth[mask]), back.deviation[mask]


def _inside(image: ViewImage, back: BackSurface, points: Array) -> Mask:
    """Which points (n, 3) a picture puts inside the object, by more than its far side may err."""
    row, column, z, within = image.project(points)
    at = row, column
    before = z < back.depth[at] - np.maximum(2.0 * back.deviation[at], 3e-3)
    behind = z > image.depth[at] + 3e-3
    inside: Mask = within & image.mask[at] & before & behind
    return inside
