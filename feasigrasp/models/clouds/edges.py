"""Pixels on the edge of what a camera sees, where depth and label are a guess."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Mask

#: Points of neighbouring pixels on an object that are farther apart lie on different surfaces [m].
EDGE_JUMP = 0.02


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
