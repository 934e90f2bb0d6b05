"""What the pads of grasps have to bear and can: the probability that a grasp carries its object.

Weight that attacks beside the closing line turns the object about it, and nothing but the friction
of the pads resists (`feasigrasp.models.grasps.pads`). About the other two axes they resist by what
they press, with much longer arms; these moments are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.shape.mass import MassEstimate

#: Of gravity, and what comes on top in any direction when the hand lifts and shakes [m/s^2].
GRAVITY, HAND_ACCELERATION = 9.81, 2.0
#: Standard deviation of the logarithm of what pads bear: of friction, and of patches on a surface
#: that is a millimetre off.
GRIP_SPREAD = 0.4


@dataclass(frozen=True, eq=False)
class Load(Frozen):
    """Loads on the pads in n grasps of one object.

    Attributes:
        closing: Closing directions, unit, in O, shape (n, 3).
        lever: From the pads to the centre of mass, in O, shape (n, 3) [m].
        body: Mass and centre of mass of the object, and their errors.
        force: Tangential force that both pads bear, shape (n,) [N].
        moment: Moment about the closing direction that both bear, shape (n,) [Nm].
    """

    closing: Array
    lever: Array
    body: MassEstimate
    force: Array
    moment: Array

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        names = ("closing", "lever", "force", "moment")
        self._freeze(**{name: np.array(getattr(self, name), dtype=float) for name in names})

    def select(self, keep: NDArray[np.generic]) -> Load:
        """The loads of the grasps that ``keep`` (mask or indices) names."""
        return replace(
            self,
            closing=self.closing[keep],
            lever=self.lever[keep],
            force=self.force[keep],
            moment=self.moment[keep],
        )

    def joined(self, other: Load) -> Load:
        """These and others of the same object behind them."""
        return replace(
            self,
            closing=np.concatenate([self.closing, other.closing]),
            lever=np.concatenate([self.lever, other.lever]),
            force=np.concatenate([self.force, other.force]),
            moment=np.concatenate([self.moment, other.moment]),
        )

    def per_kilogram(self, down: ArrayLike | None = None) -> Array:
        """Share of what the pads bear that one kilogram of the object takes, shape (n,).

        It is 1 on the limit surface, the ellipsoid ``(f / f_max)^2 + (m / m_max)^2 = 1``.

        Args:
            down: Direction of gravity in O, shape (3,); None for the worst one for each grasp.
        """
        x, r, e = self.closing, self.lever, self.body.centre_error
        along = np.einsum("ni,ni->n", r, x)
        beside = np.maximum(np.einsum("ni,ni->n", r, r) - along**2, 0.0)
        if down is None:
            sideways, turning = np.ones(len(x)), beside + e * e
        else:
            g = np.asarray(down, dtype=float)
            if g.shape != (3,) or not np.linalg.norm(g) > 0.0:
                raise GraspError(f"down = {down}: give the direction of gravity, three numbers")
            g = g / np.linalg.norm(g)
            sideways = np.maximum(1.0 - (x @ g) ** 2, 0.0)
            turning = (np.cross(x, r) @ g) ** 2 + sideways * e * e
        force = GRAVITY * np.sqrt(sideways) + HAND_ACCELERATION
        by_hand = HAND_ACCELERATION * np.sqrt(beside + 2.0 * e * e)
        moment = GRAVITY * np.sqrt(turning) + by_hand
        return np.hypot(force / self.force, moment / self.moment)

    def probability(self, down: ArrayLike | None = None) -> Array:
        """How likely the pads bear the object's weight and what the hand does to it, shape (n,).

        Args:
            down: Direction of gravity in O, shape (3,); None for the worst one for each grasp.
        """
        share = self.body.mass * self.per_kilogram(down)
        spread = np.hypot(self.body.spread, GRIP_SPREAD)
        return np.asarray(ndtr(-np.log(share) / spread))
