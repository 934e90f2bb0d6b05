"""Grasp labels of surface points, from the true mesh.

Contact pairs are searched densely on the true mesh. From the true surface point under a completed
point, lines in the friction cone give the opposite contacts; at every pair that is antipodal, the
whole hand is turned about the closing line, and the turns in which it is free are its approaches.
A label answers for the grasp that starts at a point with a closing direction b into the object:
the hand's camera may be on either side (b and -b are the same grasp, seen from its two contacts).
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.grasps.network.surface_input import GraspInput
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.training.data.grasp_label_kernels import blocked_turns, turn_table
from feasigrasp_lab.training.data.grasp_truth import CONE_DEG, TrueGrasps, hand_boxes

#: Directions in which the hand is turned about a closing line. Source: guessed.
N_TURNS = 36
#: Widths up to the opening less this [m]. Source: guessed.
SLACK = 0.004
#: An object can be grasped if valid grasps start at so many of the points of its true surface.
#: Source: definition.
GRASPABLE = 10


class PointLabels(NamedTuple):
    """The best valid grasp that starts at each of n points; zero where ``contact`` is False.

    Attributes:
        contact: Whether a valid grasp starts at the point, shape (n,).
        width: Distance between its contacts [m], shape (n,).
        closing: Its closing direction b into the object, unit, shape (n, 3).
        across: Approach direction of turn 0, unit, perpendicular to b, shape (n, 3).
        free: Turns about b in which the hand is free, shape (n, N_TURNS). Turn k has the approach
            ``cos(t) u + sin(t) (b x u)``, ``t = 2 pi k / N_TURNS``, u being ``across``.
    """

    contact: Mask
    width: Array
    closing: Array
    across: Array
    free: Mask


def find_labels(
    truth: TrueGrasps,
    points: Array,
    normals: Array,
    gripper: ParallelGripper,
    rng: np.random.Generator,
) -> PointLabels:
    """Valid grasps that start at points of a completed surface.

    Args:
        truth: The true object.
        points: Shape (n, 3), in its frame [m].
        normals: Outward unit normals, shape (n, 3).
        gripper: The hand, approaching fully open.
        rng: Turns the sets of directions that are tried.
    """
    # A completed point counts if it is this near to the true surface [m] and turned so little
    # [deg]; others are invented.
    near, aligned_deg = 0.004, 25.0
    at, outward = truth.closest(points)
    real = np.linalg.norm(at - points, axis=1) <= near
    real &= np.einsum("ij,ij->i", outward, normals) >= np.cos(np.deg2rad(aligned_deg))
    lines = _antipodal_lines(truth, np.flatnonzero(real), at, outward, gripper, rng)
    index, center, b, width, cosine = lines
    # Of the lines at a point the hand is tried on so many, those that oppose each other best.
    per_point = 2
    order = np.lexsort((-cosine, index))
    rank = np.arange(len(order)) - np.searchsorted(index[order], index[order])
    order = order[rank < per_point]
    index, center, b = index[order], center[order], b[order]
    width, cosine = width[order], cosine[order]

    across, _ = perpendiculars(b)
    free = _free_turns(truth, center, b, across, gripper)
    # The best one is well opposed, and free all round.
    score = cosine + 0.1 * free.mean(axis=1)
    kept = np.flatnonzero(free.any(axis=1))
    kept = kept[np.lexsort((-score[kept], index[kept]))]
    starts, first = np.unique(index[kept], return_index=True)

    def at_points(values: NDArray[Any]) -> NDArray[Any]:
        everywhere = np.zeros((len(points), *values.shape[1:]), values.dtype)
        everywhere[starts] = values[kept[first]]
        return everywhere

    contact = at_points(np.ones(len(index), dtype=bool))
    return PointLabels(contact, *map(at_points, (width, b, across, free)))


def is_graspable(truth: TrueGrasps, surface: GraspInput, gripper: ParallelGripper) -> bool:
    """Whether the true surface has grasps for the hand, see `GRASPABLE`."""
    points, normals = surface.points.astype(float), surface.normals.astype(float)
    labels = find_labels(truth, points, normals, gripper, np.random.default_rng(0))
    return int(labels.contact.sum()) >= GRASPABLE


def _free_turns(
    truth: TrueGrasps, center: Array, b: Array, across: Array, gripper: ParallelGripper
) -> Mask:
    """Turns about closing lines in which the open hand is free, shape (m, N_TURNS)."""
    boxes, table = _turning_hand(gripper)
    blocked = blocked_turns(truth.samples, center, b, across, boxes[:, :, 0].copy(), table)
    hand = np.bitwise_or.reduce(blocked[:, :-2], axis=1)
    # The camera blocks a turn only if it does on both sides: they are symmetric grasps.
    hand |= blocked[:, -2] & blocked[:, -1]
    bits = hand[:, None] >> np.arange(N_TURNS, dtype=np.uint64)
    free: Mask = (bits & np.uint64(1)) == 0
    return free


@lru_cache(maxsize=8)
def _turning_hand(gripper: ParallelGripper) -> tuple[Array, NDArray[np.uint64]]:
    """Boxes of the open hand, the last two the camera on either side, and their turn table."""
    # Clearance of the open hand that a label asks for [m]: what it calls valid is not marginal.
    boxes = hand_boxes(gripper, 0.0015)
    other_side = boxes[-1].copy()
    other_side[:, 1] = -boxes[-1, ::-1, 1]
    boxes = np.concatenate([boxes, other_side[None]])
    return boxes, turn_table(boxes, N_TURNS)


def _antipodal_lines(
    truth: TrueGrasps,
    index: Indices,
    at: Array,
    outward: Array,
    gripper: ParallelGripper,
    rng: np.random.Generator,
) -> tuple[Indices, Array, Array, Array, Array]:
    """Closing lines that start at true surface points and are within both friction cones.

    Returns:
        Index of the point, middle between the contacts, direction, width, cosine.
    """
    # Rays start this far before a surface [m]; faces closer than this are one contact [m]. Source:
    # numerical.
    surface = 1e-5
    same_contact = 5e-4
    opening, limit = gripper.max_opening, np.cos(np.deg2rad(CONE_DEG))
    normal = outward[index]
    lines = _cone_directions(-normal, rng)
    # The bisector of both normals is the direction that suits both faces best.
    length, far = truth.cast(at[index] - surface * normal, -normal)
    bisector = np.where(np.isfinite(length)[:, None], far - normal, -normal)
    bisector /= np.maximum(np.linalg.norm(bisector, axis=1, keepdims=True), 1e-9)
    lines = np.concatenate([lines, bisector[:, None]], axis=1)
    per_point = lines.shape[1]
    b, which = lines.reshape(-1, 3), np.repeat(index, per_point)
    steep = -np.einsum("ij,ij->i", b, outward[which]) >= limit
    b, which = b[steep], which[steep]
    start = at[which]

    through, _ = truth.cast(start - surface * outward[which], b)
    back, _ = truth.cast(start + opening * b, -b)
    outermost = opening - back
    # Nothing, or a face seen from inside: the object goes on beyond the opening.
    several = np.isfinite(outermost) & (outermost > through + same_contact)
    widths = [through, outermost[several]]
    width = np.concatenate(widths)
    b, which = np.concatenate([b, b[several]]), np.concatenate([which, which[several]])
    usable = np.isfinite(width) & (width <= opening - SLACK) & (width > same_contact)
    b, which, width = b[usable], which[usable], width[usable]

    center = at[which] + 0.5 * width[:, None] * b
    closed = truth.close_lines(center, b, opening)
    good = closed.cosine >= limit
    # The pads must meet the faces that this pair is made of, and no others on the way.
    good &= np.linalg.norm(closed.first - at[which], axis=1) < same_contact
    good &= np.abs(closed.width - width) < same_contact
    return which[good], center[good], b[good], width[good], closed.cosine[good]


def _cone_directions(axis: Array, rng: np.random.Generator) -> Array:
    """Directions on rings round unit vectors (n, 3) and these themselves, (n, k, 3)."""
    u, v = perpendiculars(axis)
    directions = [axis[:, None]]
    # Angles off the normal of the lines that are tried [deg], and how many round each. Source:
    # guessed.
    for angle_deg, count in ((7.0, 6), (14.0, 8)):
        turn = rng.uniform(0.0, 2 * np.pi, (len(axis), 1)) + 2 * np.pi * np.arange(count) / count
        side = np.cos(turn)[..., None] * u[:, None] + np.sin(turn)[..., None] * v[:, None]
        angle = np.deg2rad(angle_deg)
        directions.append(np.cos(angle) * axis[:, None] + np.sin(angle) * side)
    return np.concatenate(directions, axis=1)
