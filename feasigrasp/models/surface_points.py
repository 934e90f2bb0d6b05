"""Points on a completed surface, the value that a distance field hands on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Points of the completed surface.

    Attributes:
        points: Positions, shape (m, 3) [m].
        normals: Outward unit normals, shape (m, 3).
        variance: Predictive variance of the occupancy, shape (m,): small where it was seen.
    """

    points: Array
    normals: Array
    variance: Array

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for array in (self.points, self.normals, self.variance):
            array.flags.writeable = False

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    def __deepcopy__(self, memo: dict[int, Any]) -> SurfacePoints:
        """Immutable, so a copy is itself."""
        return self
