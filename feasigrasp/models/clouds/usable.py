"""Selection of views: their usable points, and what another view would add."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.clouds.checks import MAX_EXTENT, MIN_SPREAD, outliers, spread_across


@dataclass(frozen=True, eq=False)
class ViewRecord(Frozen):
    """The views of an object that is tracked in its own frame O.

    A view from nearly the same side adds no surface; what it still adds is an average over the
    noise, which a few views bring and more do not. And yet a side is looked at again after a while:
    what hid a part of it may be gone.

    Attributes:
        p_OC: Positions of the camera in O, shape (n, 3) [m].
        times: When it was there, shape (n,) [s].
    """

    p_OC: Array = field(default_factory=lambda: np.zeros((0, 3)))
    times: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self._freeze(p_OC=np.array(self.p_OC, dtype=float), times=np.array(self.times, dtype=float))

    def extended(self, p_OC: ArrayLike, time: float) -> "ViewRecord":
        """With one more view."""
        return ViewRecord(np.vstack([self.p_OC, p_OC]), np.append(self.times, time))

    def turned(self, p_OC: ArrayLike) -> float:
        """Angle [rad] of a camera at p_OC (3,) to the nearest view's direction; pi without any."""
        return float(np.arccos(self._cosines(p_OC).max(initial=-1.0)))

    def adds_information(self, p_OC: ArrayLike, time: float, n_views: int, revisit: float) -> bool:
        """Whether a view from p_OC (3,) [m] at a time [s] is worth taking.

        Of one side ``n_views`` suffice, unless it was not looked at for ``revisit`` [s].
        """
        distances = np.linalg.norm(self.p_OC, axis=1)
        # A view that is nearer by more than this factor sees finer.
        near = distances < 1.3 * np.linalg.norm(p_OC)
        # Views from closer directions than this show the same side (cosine).
        similar = (self._cosines(p_OC) > np.cos(np.deg2rad(10.0))) & near
        enough = int(np.count_nonzero(similar)) >= n_views
        return not enough or time - float(self.times[similar].max()) >= revisit - 1e-9

    def _cosines(self, p_OC: ArrayLike) -> Array:
        """Cosines of the angles between a camera at p_OC (3,) and every view, seen from O."""
        camera = np.asarray(p_OC, dtype=float)
        lengths = np.linalg.norm(self.p_OC, axis=1) * np.linalg.norm(camera)
        return np.clip(self.p_OC @ camera / np.maximum(lengths, 1e-12), -1.0, 1.0)


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
    """Whether all points (n, 3) in W have the same depth, which no camera measures of an object.

    Not even of a plane: it would be at right angles to the camera's axis within a thousandth.
    """
    depth = (points - X_WC[:3, 3]) @ X_WC[:3, 2]
    # Depths that differ less all over an object are not measured: a camera's noise is larger [m].
    return len(points) > 0 and float(np.ptp(depth)) < 1e-4


def usable_points(
    points: Array, p_OC: ArrayLike, min_points: int, known: Array
) -> tuple[Array, ViewFault | None, str]:
    """The points of a view without its outliers, if they can be those of an object.

    Finite points (n, 3), the camera's position (3,), and points (k, 3) of earlier views are in O
    [m]. With a mask that is too large, or beside the object, what lies far behind it is in the view
    as well, and nothing else when the hand is so close that the camera does not see the object.
    Fewer than ``min_points`` show nothing. With the points that are left, (m, 3), comes what is
    wrong with the view, None if nothing is, and by what figures.
    """
    # Largest extent of an object beyond the observed surface [m]; points that do show that the mask
    # is wrong, unless all of them do and could be the object: then it is elsewhere.
    beyond, like_the_object = 0.1, 1.5
    bad = outliers(points, p_OC)
    kept = points[~bad]
    # A view of which less remains without its outliers shows no object.
    if len(kept) < max(min_points, 0.5 * len(bad)):
        return kept, ViewFault.MOSTLY_OUTLIERS, f"{bad.sum()} of {len(bad)} points"
    if spread_across(kept) < MIN_SPREAD:
        return kept, ViewFault.NO_SURFACE, f"{len(kept)} points"
    unlike = False
    if len(known) > 0:
        lower, upper = known.min(axis=0), known.max(axis=0)
        near = ((kept >= lower - beyond) & (kept <= upper + beyond)).all(axis=1)
        size, most = np.linalg.norm(np.ptp(kept, axis=0)), np.linalg.norm(upper - lower)
        if np.count_nonzero(near) >= min_points:
            kept = kept[near]
        else:
            unlike = bool(size > like_the_object * most)
    extent = float(np.ptp(kept, axis=0).max())
    if extent > MAX_EXTENT:
        return kept, ViewFault.TOO_WIDE, f"{extent:.3g} m, more than {MAX_EXTENT:g} m"
    if unlike:
        return kept, ViewFault.BACKGROUND, f"{size:.3g} m of it, the object has {most:.3g} m"
    return kept, None, ""
