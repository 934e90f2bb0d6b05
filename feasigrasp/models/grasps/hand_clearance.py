"""Clearance of the open hand from a completed surface, with its probability."""

from functools import lru_cache

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet
from feasigrasp.models.grasps.success_probability import free_probability
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.shape.gpdf import INVENTED, MARGIN_GROWTH, Gpdf, surface_deviation
from feasigrasp.models.shape.scene_field import SceneField


def scene_clear(scene: SceneField, X_WG: Array, gripper: Gripper, margin: float) -> Mask:
    """Mask (n,) of poses (n, 4, 4) at which the open hand keeps a margin [m] from a scene in W."""
    points = _placed(gripper.surface_points(gripper.max_opening), X_WG)
    hits = scene.closer_than(points.reshape(-1, 3), margin)
    return np.asarray(~hits.reshape(points.shape[:2]).any(axis=1))


def unobserved_clear(scene: SceneField, X_WG: Array, gripper: Gripper, margin: float) -> Mask:
    """Mask of open-hand poses with clearance from unobserved space; as `scene_clear`."""
    points = _placed(gripper.surface_points(gripper.max_opening), X_WG)
    distance = scene.unobserved_distance(points.reshape(-1, 3), margin)
    return np.asarray((distance >= margin).reshape(points.shape[:2]).all(axis=1))


def _placed(hand: Array, X: Array) -> Array:
    """Points (k, 3) on a hand at each of n poses, shape (n, k, 3) [m]."""
    points: Array = np.einsum("nij,kj->nki", X[:, :3, :3], hand) + X[:, None, :3, 3]
    return points


#: Least distance of the open hand from completed surface that was seen [m]. Source: guessed.
MARGIN = 0.003
#: Further away than this a hand is certainly free [m]. Source: guessed.
FAR = 0.012
#: In walls thinner than this the field's normals may point to either side [m]: there only a network
#: can decide whether two contacts oppose each other. Source: guessed.
THIN_WALL = 0.010
#: A hand that collides with nothing but `INVENTED` surface stays, if a network finds it as likely
#: as this that the grasp is good. Source: reasoned: even odds.
HOPEFUL = 0.5


def hand_freedom(
    gpdf: Gpdf, grasps: GraspSet, learned: Array, gripper: Gripper, enough: int
) -> tuple[Mask, Array]:
    """Mask of collision-free open hands, with probabilities.

    Where a wall is thin, the field fills what it encloses; and what it closes a shape with, far
    from all that was seen, is a guess. While fewer than ``enough`` hands are free, what lies in
    known free space does not count.

    Of n grasps, whose scores are the probabilities of their contacts, and the probability that the
    hand is free as a network estimates it, shape (n,), NaN where it has no opinion: which are free,
    and how probable that is of each, shapes (n,).
    """
    clearance, deviation = hand_clearance(gpdf, grasps.X_OG, gripper)
    free = clearance >= MARGIN + MARGIN_GROWTH * deviation
    in_doubt = np.zeros(len(grasps), dtype=bool)
    if gpdf.has_free_space:
        in_doubt = ~free & (grasps.score * np.nan_to_num(learned) >= HOPEFUL)
        few = np.count_nonzero(free) < enough
        again = ~free & ~in_doubt & (few | (grasps.width < THIN_WALL))
        clearance[again] = observed_clearance(gpdf, grasps.X_OG[again], gripper)
        free[again] = clearance[again] >= MARGIN + MARGIN_GROWTH * deviation[again]
        apart = observed_clearance(gpdf, grasps.X_OG[in_doubt], gripper, INVENTED)
        free[in_doubt] = apart >= MARGIN
    return free, free_probability(clearance, deviation, learned, in_doubt)


def hand_clearance(gpdf: Gpdf, X_OG: Array, gripper: Gripper) -> tuple[Array, Array]:
    """Clearance of the whole open hand from the surface, for the worse of both flips.

    Of poses (n, 4, 4): least distance (n,), at most `FAR` [m], and the predicted deviation of the
    surface where the hand is closest, shape (n,) [m]. A hand closer than `MARGIN` collides; how
    much closer it is does not matter.
    """
    hand = _either_way_round(gripper)
    clearance, closest = gpdf.clearance(X_OG, hand, FAR, MARGIN)
    deviation = np.zeros(len(X_OG))
    at = np.flatnonzero(closest >= 0)
    points = np.einsum("nij,nj->ni", X_OG[at, :3, :3], hand[closest[at]]) + X_OG[at, :3, 3]
    deviation[at] = surface_deviation(gpdf, points)
    return clearance, deviation


def observed_clearance(
    gpdf: Gpdf, X_OG: Array, gripper: Gripper, invented: float = np.inf
) -> Array:
    """Clearance as in `hand_clearance`, but without surface in observed free space.

    The field fills bowls and cups; a finger may enter them where the camera has seen the inside.
    Surface farther than ``invented`` [m] from observations counts as far as well. Raw distances
    (n,) [m], which are less than the true ones outside.
    """
    hand = _either_way_round(gripper)
    points = _placed(hand, X_OG).reshape(-1, 3)
    clearance = np.full(len(points), FAR)
    counts = gpdf.possible(points)
    if np.isfinite(invented):
        counts &= nearest_distance(points, gpdf.seen()[0]) < invented
    clearance[counts] = np.minimum(gpdf.distance(points[counts]), FAR)
    return clearance.reshape(len(X_OG), len(hand)).min(axis=1, initial=FAR)


@lru_cache(maxsize=8)
def _either_way_round(gripper: Gripper) -> Array:
    """Points on the open hand and on its flip, without those that coincide, shape (k, 3) [m]."""
    hand = gripper.surface_points(gripper.max_opening)
    hand = np.concatenate([hand, hand @ FLIP[:3, :3]])
    hand = hand[np.sort(np.unique(hand.round(9), axis=0, return_index=True)[1])]
    hand.flags.writeable = False
    return np.asarray(hand)
