"""Selection of the usable points of a view, with the reason for a rejection."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import MAX_EXTENT, MIN_SPREAD, spread_across
from feasigrasp.models.clouds.outliers import outliers

#: A view of which less remains without its outliers shows no object.
_LEAST_KEPT = 0.5
#: Largest extent of an object beyond the observed surface [m]; points that do show that the
#: mask is wrong, unless all of them do and could be the object: then it is elsewhere.
_BEYOND, _LIKE_THE_OBJECT = 0.1, 1.5
#: Depths that differ less all over an object are not measured: a camera's noise is larger [m].
_ONE_DEPTH = 1e-4


class ViewFault(StrEnum):
    """Why a view could not be used."""

    UNKNOWN_POSE = "the pose of object or camera is unknown"
    NOT_FINITE = "no finite point"
    TOO_WIDE = "too wide for an object"
    MOSTLY_OUTLIERS = "mostly outliers"
    BACKGROUND = "nothing but background"
    ONE_DEPTH = "the same depth everywhere"
    NO_SURFACE = "points on a spot or line"
    NO_FIELD = "no field fits"
    OUTVOTED = "later views agree on another place"


def of_one_depth(points: Array, X_WC: Array) -> bool:
    """Whether all points have the same depth, which no camera measures of an object.

    Not even of a plane: it would be at right angles to the camera's axis within a thousandth.

    Args:
        points: In W, shape (n, 3) [m].
        X_WC: Pose of the camera, z forward, shape (4, 4).
    """
    depth = (points - X_WC[:3, 3]) @ X_WC[:3, 2]
    return len(points) > 0 and float(np.ptp(depth)) < _ONE_DEPTH


def usable_points(
    points: Array, p_OC: ArrayLike, min_points: int, known: Array
) -> tuple[Array, ViewFault | None, str]:
    """The points of a view without its outliers, if they can be those of an object.

    Args:
        points: Finite points in O, shape (n, 3) [m].
        p_OC: Position of the camera in O, shape (3,) [m].
        min_points: Fewer show nothing.
        known: Points of earlier views, shape (k, 3) [m]. With a mask that is too large, or beside
            the object, what lies far behind it is in the view as well, and nothing else when the
            hand is so close that the camera does not see the object.

    Returns:
        The points that are left, shape (m, 3); what is wrong with the view, None if nothing is; and
        by what figures.
    """
    bad = outliers(points, p_OC)
    kept = points[~bad]
    if len(kept) < max(min_points, _LEAST_KEPT * len(bad)):
        return kept, ViewFault.MOSTLY_OUTLIERS, f"{bad.sum()} of {len(bad)} points"
    if spread_across(kept) < MIN_SPREAD:
        return kept, ViewFault.NO_SURFACE, f"{len(kept)} points"
    unlike = False
    if len(known) > 0:
        lower, upper = known.min(axis=0), known.max(axis=0)
        near = ((kept >= lower - _BEYOND) & (kept <= upper + _BEYOND)).all(axis=1)
        size, most = np.linalg.norm(np.ptp(kept, axis=0)), np.linalg.norm(upper - lower)
        if np.count_nonzero(near) >= min_points:
            kept = kept[near]
        else:
            unlike = bool(size > _LIKE_THE_OBJECT * most)
    extent = float(np.ptp(kept, axis=0).max())
    if extent > MAX_EXTENT:
        return kept, ViewFault.TOO_WIDE, f"{extent:.3g} m, more than {MAX_EXTENT:g} m"
    if unlike:
        return kept, ViewFault.BACKGROUND, f"{size:.3g} m of it, the object has {most:.3g} m"
    return kept, None, ""
