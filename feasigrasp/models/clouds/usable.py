"""What of a view can be used, and why one cannot."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import MAX_EXTENT
from feasigrasp.models.clouds.outliers import outliers

#: A view of which less remains without its outliers shows no object.
_LEAST_KEPT = 0.5


class ViewFault(StrEnum):
    """Why a view could not be used."""

    UNKNOWN_POSE = "the pose of object or camera is unknown"
    NOT_FINITE = "no finite point"
    TOO_WIDE = "too wide for an object"
    MOSTLY_OUTLIERS = "mostly outliers"
    NO_SURFACE = "points on a spot or line"
    NO_FIELD = "no field fits"


def usable_points(
    points: Array, p_OC: ArrayLike, min_points: int
) -> tuple[Array, ViewFault | None, str]:
    """The points of a view without its outliers, if they can be those of an object.

    Args:
        points: Finite points in O, shape (n, 3) [m].
        p_OC: Position of the camera in O, shape (3,) [m].
        min_points: Fewer show nothing.

    Returns:
        The points that are left, shape (m, 3); what is wrong with the view, None if nothing is; and
        by what figures.
    """
    bad = outliers(points, p_OC)
    kept = points[~bad]
    if len(kept) < max(min_points, _LEAST_KEPT * len(bad)):
        return kept, ViewFault.MOSTLY_OUTLIERS, f"{bad.sum()} of {len(bad)} points"
    extent = float(np.ptp(kept, axis=0).max())
    if extent > MAX_EXTENT:
        return kept, ViewFault.TOO_WIDE, f"{extent:.3g} m, more than {MAX_EXTENT:g} m"
    return kept, None, ""
