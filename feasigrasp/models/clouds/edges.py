"""Pixels on the edge of what a camera sees, where depth and label are a guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from feasigrasp.models.arrays import Mask

#: Points of neighbouring pixels on an object that are farther apart lie on different surfaces [m].
EDGE_JUMP = 0.02
#: A mask of fewer pixels shows too little of an object, and is grown by so many [pixels].
SCANTY, GROWTH = 150, 10


def edge_pixels(
    points: NDArray[np.floating],
    seen: Mask,
    of_body: Mask,
    jump: float,
) -> Mask:
    """Pixels with a neighbour, of the four, that shows another surface.

    That is one whose point is farther away than ``jump``, or one without a point that does not
    belong to the body. (A lost pixel amid the body is a hole in the measurement, not an edge.)

    Args:
        points: Points by pixel, shape (3, h, w) [m].
        seen: Which pixels have a point, shape (h, w).
        of_body: Which pixels show the body, shape (h, w).
        jump: See above [m].

    Returns:
        Shape (h, w).
    """
    edge = np.zeros(seen.shape, dtype=bool)
    for one, next_ in (
        (np.s_[:-1, :], np.s_[1:, :]),
        (np.s_[:, :-1], np.s_[:, 1:]),
    ):
        with np.errstate(invalid="ignore"):  # infinity minus infinity, where nothing was seen
            square = np.square(points[:, *next_] - points[:, *one]).sum(axis=0)
        apart = seen[one] & seen[next_] & (square > jump**2)
        edge[one] |= apart | ~(seen[next_] | of_body[next_])
        edge[next_] |= apart | ~(seen[one] | of_body[one])
    return edge


def grown_mask(points: NDArray[np.floating], mask: Mask, free: Mask, jump: float) -> Mask:
    """A mask of too few pixels, grown along the surface that it is on; any other as it is.

    It grows up to the edges of the surface, and by `GROWTH` pixels at most: so one that misses the
    object's rim is mended, and one that lies on a wall does not become the wall.

    Args:
        points: Points by pixel, not finite where nothing was seen, shape (3, h, w) [m].
        mask: Pixels that are taken for the object, shape (h, w).
        free: Pixels that are not known to show anything else, shape (h, w).
        jump: See `edge_pixels` [m].

    Returns:
        Shape (h, w).
    """
    if not 0 < np.count_nonzero(mask) < SCANTY:
        return mask
    seen = np.isfinite(points).all(axis=0)
    surface = seen & (free | mask) & ~edge_pixels(points, seen, mask, jump)
    return mask | binary_dilation(mask & surface, iterations=GROWTH, mask=surface)
