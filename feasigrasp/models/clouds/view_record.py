"""Record of viewing directions, and the information value of another view."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Frozen

#: Views from closer directions than this show the same side (cosine) ...
SAME_DIRECTION = np.cos(np.deg2rad(10.0))
#: ... unless one is nearer by more than this factor, and sees finer.
SAME_DISTANCE = 1.3


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
        """Freezes the arrays."""
        self._freeze(p_OC=np.array(self.p_OC, dtype=float), times=np.array(self.times, dtype=float))

    def extended(self, p_OC: ArrayLike, time: float) -> ViewRecord:
        """With one more view."""
        return ViewRecord(np.vstack([self.p_OC, p_OC]), np.append(self.times, time))

    def turned(self, p_OC: ArrayLike) -> float:
        """Angle of a camera at p_OC (3,) to the nearest direction of a view [rad]; pi without any.

        Without any view every side is another one.
        """
        return float(np.arccos(self._cosines(p_OC).max(initial=-1.0)))

    def adds_information(self, p_OC: ArrayLike, time: float, n_views: int, revisit: float) -> bool:
        """Whether a view is worth taking.

        Args:
            p_OC: Where the camera would be, shape (3,) [m].
            time: When [s].
            n_views: So many views of one side suffice.
            revisit: A side not looked at for so long is looked at again [s].
        """
        distances = np.linalg.norm(self.p_OC, axis=1)
        near = distances < SAME_DISTANCE * np.linalg.norm(p_OC)
        similar = (self._cosines(p_OC) > SAME_DIRECTION) & near
        enough = int(np.count_nonzero(similar)) >= n_views
        return not enough or time - float(self.times[similar].max()) >= revisit - 1e-9

    def _cosines(self, p_OC: ArrayLike) -> Array:
        """Cosines of the angles between a camera at p_OC (3,) and every view, seen from O."""
        camera = np.asarray(p_OC, dtype=float)
        lengths = np.linalg.norm(self.p_OC, axis=1) * np.linalg.norm(camera)
        return np.clip(self.p_OC @ camera / np.maximum(lengths, 1e-12), -1.0, 1.0)
