"""Grasps that carry: those whose pads bear the object's weight are kept, the others counted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.load import Load
from feasigrasp.models.grasps.pads import grip_of
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.mass import estimate_mass

#: Friction of rubber on household surfaces; and the share of the moments of its patches that pads
#: are trusted with. It is a choice: but for boxes, patches are smaller than they look on a
#: completed surface, not quite opposite each other, and what they press beside takes friction.
FRICTION, MOMENT_SHARE = 0.6, 0.35
#: A grasp is sure to carry if it is so likely. Objects are there to be carried: one that seems too
#: heavy for all grasps is taken to be so light that the best one carries it with ``BEST``.
SURE, BEST = 0.7, 0.76
#: One that is by this factor less likely than what is asked of it does not carry.
_HOPELESS = 0.2


@dataclass(frozen=True, eq=False)
class Carrier:
    """What is known before anything is seen: the hand, perhaps the mass.

    Attributes:
        gripper: The hand.
        mass: Mass of the object, if it is known [kg].

    Raises:
        GraspError: The mass is not a positive number.
    """

    gripper: ParallelGripper
    mass: float | None = None

    def __post_init__(self) -> None:
        """Checks the mass."""
        if self.mass is not None and not 0.0 < self.mass < np.inf:
            raise GraspError(f"mass = {self.mass}: give kilograms, or None if it is not known")

    def loaded(self, gpdf: Gpdf, grasps: GraspSet) -> GraspSet:
        """The same grasps with what their pads would bear (`GraspSet.load`)."""
        if len(grasps) == 0:
            return grasps
        grip = grip_of(gpdf, grasps, self.gripper)
        body = estimate_mass(gpdf, self.mass)
        load = Load(
            R_OG=grasps.X_OG[:, :3, :3],
            lever=body.p_OC - grip.p_OP,
            body=body,
            force=np.full(len(grasps), FRICTION * grip.force),
            moment=MOMENT_SHARE * grip.moment * [FRICTION, 1.0, 1.0],
        )
        return replace(grasps, load=load)


def rated(grasps: GraspSet, down: ArrayLike | None = None) -> GraspSet:
    """The grasps with how sure they are to carry.

    Args:
        grasps: Grasps in O with their loads; without them they are returned as they are.
        down: Direction of gravity in O, shape (3,). Without it the worst one for each grasp counts,
            and none is dropped: it may yet be lifted another way.

    Returns:
        Best first, their scores multiplied by the probability that the pads bear the load, of an
        object that one of them carries (`BEST`). Over what is asked, `SURE`, it is
        `GraspSet.carries`. What hardly carries counts as "too heavy there" and is dropped.
    """
    if grasps.load is None or len(grasps) == 0:
        return grasps
    likely = grasps.load.probability(down, BEST)
    ranked = replace(grasps, score=grasps.score * likely, carries=likely / SURE)
    ranked = ranked.select(np.argsort(-ranked.score, kind="stable"))
    return ranked if down is None else surer(ranked, _HOPELESS)


def carried(grasps: GraspSet, down: ArrayLike | None = None) -> GraspSet:
    """The grasps that carry, as far as one can tell, for who does not know what is in reach.

    Arguments as for `rated`. Those of its grasps stay that are sure, and without ``down`` all.
    """
    some = rated(grasps, down)
    return some if down is None else surer(some, 1.0)


def surer(grasps: GraspSet, least: float) -> GraspSet:
    """The grasps that are as sure to carry as that; all if nobody has told how sure they are."""
    if grasps.carries is None:
        return grasps
    return grasps.select(np.flatnonzero(grasps.carries >= least), Rejection.TOO_HEAVY)
