"""Mass of an object, load of the finger pads, and the probability that friction bears it.

Weight that attacks beside the closing line turns the object about it, and nothing but the friction
of the pads resists (`feasigrasp.models.grasps.payload`). About the other two axes they resist by
where they press: on small patches, such as a hammer's head between the pads, that is not much more.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.shape.gpdf import Gpdf

# Mass and center of mass of a completed shape, with their uncertainty.
#
# The inside of an object is unobserved. Small household objects are solid, large ones hollow: their
# mass grows about as their surface does, with the volume to the power of two thirds, and is known
# by that to a factor of about two. The centre of mass is taken for that of the volume.

#: Median mass of household objects of half a litre, as a field sees them, filled [kg]; the standard
#: deviation of its logarithm. Source: guessed.
TYPICAL_VOLUME, TYPICAL_MASS, MASS_SPREAD = 5e-4, 0.35, 0.6


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
        self._freeze(p_OC=np.array(self.p_OC, dtype=float).reshape(3))


def estimate_mass(gpdf: Gpdf, mass: float | None = None) -> MassEstimate:
    """Mass and centre of mass of a completed shape; the mass is given if it is known [kg]."""
    # Points per axis at which the field is asked for inside and outside.
    grid = 12
    surface = gpdf.completion.points
    lower, upper = surface.min(axis=0), surface.max(axis=0)
    step = (upper - lower) / grid
    axes = lower + (np.arange(grid)[:, None] + 0.5) * step
    points = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = gpdf.distance(points) < 0.0
    inside[inside] = gpdf.possible(points[inside])
    # A wall that is thinner than the grid is all surface.
    filled = points[inside] if inside.any() else surface
    centre = filled.mean(axis=0)
    gyration = float(np.sqrt(((filled - centre) ** 2).sum(axis=1).mean()))
    volume = max(1, int(np.count_nonzero(inside))) * float(np.prod(step))
    typical = TYPICAL_MASS * (volume / TYPICAL_VOLUME) ** (2.0 / 3.0)
    # What somebody has weighed is known better.
    mass, spread = (typical, MASS_SPREAD) if mass is None else (mass, 0.05)
    # The deviation of the centre of mass is a share of the radius of gyration of the volume.
    return MassEstimate(mass, spread, centre, 0.2 * gyration)


#: Of gravity, and what comes on top in any direction when the hand lifts and shakes [m/s^2].
#: Source: definition: gravity; the hand's own motion is guessed.
GRAVITY, HAND_ACCELERATION = 9.81, 2.0
#: Standard deviation of the logarithm of what pads bear: of friction, and of patches on a surface
#: that is a millimetre off. Source: guessed.
GRIP_SPREAD = 0.4


def unit_gravity(down: ArrayLike) -> Array:
    """Direction of gravity as a unit vector (3,).

    Raises:
        GraspError: It is none.
    """
    g = np.asarray(down, dtype=float)
    if g.shape != (3,) or not np.linalg.norm(g) > 0.0:
        raise GraspError(f"down = {down!r}: give the direction of gravity, three numbers")
    return np.asarray(g / np.linalg.norm(g))


@dataclass(frozen=True, eq=False)
class Load(Frozen, ABC):
    """Loads on a hand in n grasps of one object.

    Attributes:
        R_OG: Axes of the grasp frames, in O, shape (n, 3, 3).
        lever: From the contact to the centre of mass, in O, shape (n, 3) [m].
        body: Mass and centre of mass of the object, and their errors.
    """

    R_OG: Array
    lever: Array
    body: MassEstimate
    _per_grasp: ClassVar[tuple[str, ...]] = ("R_OG", "lever")

    def __post_init__(self) -> None:
        self._freeze(**{k: np.array(getattr(self, k), dtype=float) for k in self._per_grasp})

    def select(self, keep: NDArray[np.generic]) -> Self:
        """The loads of the grasps that ``keep`` (mask or indices) names."""
        parts: dict[str, Any] = {k: getattr(self, k)[keep] for k in self._per_grasp}
        return replace(self, **parts)

    def joined(self, other: "Load") -> Self:
        """Concatenation of two loads of the same object."""
        pairs = {k: (getattr(self, k), getattr(other, k)) for k in self._per_grasp}
        parts: dict[str, Any] = {k: np.concatenate(pair) for k, pair in pairs.items()}
        return replace(self, **parts)

    @abstractmethod
    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """Share of what the hand bears that one kilogram of the object takes, shape (n,).

        The direction of gravity ``down`` is in O, shape (3,); None for the worst one.
        """

    def probability(self, down: ArrayLike | None = None, best: float | None = None) -> Array:
        """Probability that the hand bears weight and inertial load, shape (n,).

        Args:
            down: Direction of gravity in O, shape (3,); None for the worst one for each grasp.
            best: The object is no heavier than one of the grasps carries so likely; without it, as
                heavy as estimated.
        """
        share = self.body.mass * self.per_kilogram(down)
        spread = np.hypot(self.body.spread, GRIP_SPREAD)
        margin = -np.log(share) / spread
        if best is not None and np.isfinite(margin.max()):  # else none bears anything
            margin += max(0.0, ndtri(best) - margin.max())
        return np.asarray(ndtr(margin))


@dataclass(frozen=True, eq=False)
class PadLoad(Load):
    """Loads on the pads in n grasps of one object.

    Attributes:
        force: Tangential force that both pads bear, shape (n,) [N].
        moment: Moments about the axes of the grasp frame that both bear, shape (n, 3) [Nm].
    """

    force: Array
    moment: Array
    _per_grasp = (*Load._per_grasp, "force", "moment")

    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """See `Load.per_kilogram`; without ``down`` gravity is the worst one for each moment.

        The share is 1 on the limit surface, the ellipsoid ``(f / f_max)^2 + sum_i (m_i /
        m_max,i)^2 = 1``.
        """
        r, e = np.einsum("nji,nj->ni", self.R_OG, self.lever), self.body.centre_error
        beside = (r**2).sum(axis=1, keepdims=True) - r**2  # squared, of every axis
        if down is None:
            sideways, turning = np.ones(len(r)), beside + e * e
        else:
            g = self.R_OG.transpose(0, 2, 1) @ unit_gravity(down)
            across = np.maximum(1.0 - g**2, 0.0)
            sideways, turning = across[:, 0], np.cross(r, g) ** 2 + across * e * e
        force = GRAVITY * np.sqrt(sideways) + HAND_ACCELERATION
        by_hand = HAND_ACCELERATION * np.sqrt(beside + 2.0 * e * e)
        moment = GRAVITY * np.sqrt(turning) + by_hand
        with np.errstate(divide="ignore"):  # a patch of one cell bears no moment
            shares = np.column_stack([force / self.force, moment / self.moment])
        return np.asarray(np.linalg.norm(shares, axis=1))
