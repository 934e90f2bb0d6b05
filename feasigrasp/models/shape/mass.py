"""Mass and center of mass of a completed shape, with their uncertainty.

The inside of an object is unobserved. Small household objects are solid, large ones hollow: their
mass grows about as their surface does, with the volume to the power of two thirds, and is known by
that to a factor of about two. The centre of mass is taken for that of the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.shape.gpdf import Gpdf

#: Median mass of household objects of half a litre, as a field sees them, filled [kg]; the standard
#: deviation of its logarithm.
TYPICAL_VOLUME, TYPICAL_MASS, MASS_SPREAD = 5e-4, 0.35, 0.6
#: The same of a mass that somebody has weighed.
WEIGHED_SPREAD = 0.05
#: Standard deviation of the centre of mass along each axis, per radius of gyration of the volume.
CENTRE_SPREAD = 0.2
#: Points per axis at which the field is asked for inside and outside.
_GRID = 12


@dataclass(frozen=True, eq=False)
class MassEstimate(Frozen):
    """A mass with a log-normal error, and a centre of mass with a normal one.

    Attributes:
        mass: Median [kg].
        spread: Standard deviation of its logarithm.
        p_OC: Expected centre of mass, in the frame of the field, shape (3,) [m].
        centre_error: Standard deviation of the centre of mass along each axis [m].
    """

    mass: float
    spread: float
    p_OC: Array
    centre_error: float

    def __post_init__(self) -> None:
        """Freezes the array."""
        self._freeze(p_OC=np.array(self.p_OC, dtype=float).reshape(3))


def estimate_mass(gpdf: Gpdf, mass: float | None = None) -> MassEstimate:
    """Mass and centre of mass of a completed shape.

    Args:
        gpdf: Distance field in frame O.
        mass: The mass, if it is known [kg].
    """
    surface = gpdf.completion.points
    lower, upper = surface.min(axis=0), surface.max(axis=0)
    step = (upper - lower) / _GRID
    axes = lower + (np.arange(_GRID)[:, None] + 0.5) * step
    points = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = gpdf.distance(points) < 0.0
    inside[inside] = gpdf.possible(points[inside])
    # A wall that is thinner than the grid is all surface.
    filled = points[inside] if inside.any() else surface
    centre = filled.mean(axis=0)
    gyration = float(np.sqrt(((filled - centre) ** 2).sum(axis=1).mean()))
    volume = max(1, int(np.count_nonzero(inside))) * float(np.prod(step))
    typical = TYPICAL_MASS * (volume / TYPICAL_VOLUME) ** (2.0 / 3.0)
    return MassEstimate(
        mass=typical if mass is None else mass,
        spread=MASS_SPREAD if mass is None else WEIGHED_SPREAD,
        p_OC=centre,
        centre_error=CENTRE_SPREAD * gyration,
    )
