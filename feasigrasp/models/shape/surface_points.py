"""Points on a completed surface, the value that a distance field hands on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

from feasigrasp.models.arrays import Array, Frozen


@dataclass(frozen=True, eq=False)
class SurfacePoints(Frozen):
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
        self._freeze(points=self.points, normals=self.normals)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    @cached_property
    def variance(self) -> Array:
        """Predictive variance of the occupancy, shape (m,): small where it was seen.

        Computed when it is asked for: it costs more than the points.
        """
        variance = self.variance_at(self.points)
        variance.flags.writeable = False
        return variance
