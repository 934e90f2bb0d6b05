"""Points on a completed surface, the value that a distance field hands on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
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
        variance_at: Predictive variance of the occupancy at points (k, 3), shape (k,).
    """

    points: Array
    normals: Array
    variance_at: Callable[[Array], Array] = field(repr=False)

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for array in (self.points, self.normals):
            array.flags.writeable = False

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    def __deepcopy__(self, memo: dict[int, Any]) -> SurfacePoints:
        """Immutable, so a copy is itself."""
        return self

    @cached_property
    def variance(self) -> Array:
        """Predictive variance of the occupancy, shape (m,): small where it was seen.

        Computed when it is asked for: it costs more than the points.
        """
        variance = self.variance_at(self.points)
        variance.flags.writeable = False
        return variance
