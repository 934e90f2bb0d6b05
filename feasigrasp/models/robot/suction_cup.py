"""Suction cups."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.quantities import NotNegative, Number, Positive
from feasigrasp.models.robot.gripper import Gripper, Length


@dataclass(frozen=True, eq=False)
class SuctionCup(Gripper):
    """A round suction cup on a stem, described in its grasp frame G.

    The origin of G is the middle of the unloaded lip, z points out of the cup. Any turn about z is
    the same grasp. The defaults are a soft cup of 30 mm, with the reach and camera of the packaged
    hand.

    Attributes:
        radius: Of the lip [m].
        height: Of the cup, from its lip to its apex on the stem [m].
        stem_radius: Of the stem between palm and cup [m].
        press: How far the lip is pressed in where the hand is at a grasp [m].
        max_strain: Share by which the springs of the cup change their lengths at most before the
            lip opens (see `feasigrasp.models.grasps.suction`).
        vacuum: Pressure below that of the air in a sealed cup [Pa].
        friction: Coulomb friction of the lip.
    """

    radius: Length = 0.015
    height: Length = 0.012
    stem_radius: Length = 0.010
    press: Length = 0.002
    max_strain: Positive = 0.05
    vacuum: Annotated[float, Number(above=0.0, unit="Pa")] = 60e3
    friction: Positive = 0.5

    @property
    def max_opening(self) -> float:
        """A cup does not open; below zero its vacuum is on [m]."""
        return 0.0

    @property
    def tip(self) -> float:
        """Its lip is in the origin [m]."""
        return 0.0

    @property
    def vacuum_force(self) -> float:
        """Force of the vacuum on what closes the lip, ``p pi r^2`` [N]."""
        return float(self.vacuum * np.pi * self.radius**2)

    @property
    def reach(self) -> tuple[float, float, float]:
        """Largest x and y of the cup, and its lip's z [m]."""
        return self.radius, self.radius, self.tip

    @checked(GraspError)
    def fingers(self, opening: float) -> list[list[list[float]]]:
        """Lower and upper corners in G of boxes around stem and cup [m]."""
        r, s, back = self.radius, self.stem_radius, -self.height
        return [[[-s, -s, self.heel], [s, s, back]], [[-r, -r, back], [r, r, 0.0]]]

    def capsules(self) -> list[tuple[list[float], list[float], float]]:
        """Ends in G and radius of a capsule around stem and cup [m]."""
        radius = 1.3 * max(self.radius, self.stem_radius)
        top = -float(np.sqrt(radius**2 - self.radius**2))
        return [([0.0, 0.0, self.heel], [0.0, 0.0, top], radius)]

    @checked(GraspError)
    def surface_points(self, opening: NotNegative) -> Array:
        """Points on stem, back of the cup, palm and camera, (k, 3) [m]; the lip is to touch."""
        back = -self.height
        stem = np.linspace(back, self.heel, 4)[:-1]
        around = [_rings([self.radius], [back, 0.7 * back]), _rings([self.stem_radius], stem)]
        return np.concatenate([*around, self._body_points()])

    def skin_points(self) -> Array:
        """Points all over cup, stem, palm and camera, the lip included, shape (k, 3) [m]."""
        depth = np.linspace(0.0, -self.height, 3)
        rings = _rings([0.0, 0.5 * self.radius, self.radius], depth)
        stem = _rings([self.stem_radius], np.linspace(-self.height, self.heel, 5))
        return np.concatenate([rings, stem, self._body_skin()])


def _rings(radii: ArrayLike, z: ArrayLike) -> Array:
    """Eight points on each circle about z, shape (k, 3)."""
    angle = np.arange(8) * np.pi / 4
    r, a, z = np.meshgrid(radii, angle, z, indexing="ij")
    return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)
