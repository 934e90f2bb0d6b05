"""Post-filter of parallel-jaw grasps against a completed surface.

Choi & Figueroa (arXiv 2311.02576, "Data-driven grasp sampler"): gripper points must lie outside
the surface, and the normals at the two contacts must oppose each other. Here the second contact is
``c2 = c1 + w b`` with b pointing from c1 into the object; the authors' script forgets the
translation in that look-up. Beyond the paper, the margin of the hand grows with the uncertainty of
the surface beside it, and what is left is scored by the probability that it is a true grasp.
"""

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import ConvexHull, QhullError

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.grasps.grasp_set import ENOUGH, FLIP, GraspSet, Rejection, contacts
from feasigrasp.models.grasps.hand_clearance import MARGIN, THIN_WALL, hand_freedom
from feasigrasp.models.grasps.success_probability import contact_evidence, contact_probability
from feasigrasp.models.quantities import CLOUD, POSES, ArrayOf, Positive
from feasigrasp.models.robot.gripper import Gripper, ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf, unit_normals

#: Largest cosines allowed between opposed contact normals, strictest first; a weaker one is used
#: only while fewer than `ENOUGH` grasps pass. Source: guessed.
COSINE_STEPS = (-0.8, -0.7, -0.6)


@checked(GraspError)
def filter_grasps(
    gpdf: Gpdf,
    X_OG: Annotated[ArrayLike, POSES],
    width: Annotated[ArrayLike, ArrayOf(("n",), "m")],
    gripper: ParallelGripper,
    *,
    prior: Annotated[ArrayLike, ArrayOf(("n", 2), finite=False)] | None = None,
) -> GraspSet:
    """Keeps the grasps that fit the hand, hold the object and collide with nothing.

    A grasp and its 180-degree flip are the same grasp, and whoever takes it chooses between them:
    the hand has to be clear of the object either way round. The field's table may block one way;
    then the other one is handed on.

    Args:
        gpdf: Distance field in frame O.
        X_OG: Candidate grasp frames, shape (n, 4, 4).
        width: Distance between the contacts, shape (n,) [m].
        gripper: The hand; it approaches fully open.
        prior: Estimate of a network, shape (n, 2): the probabilities that the contacts are good and
            that the hand is free, the latter NaN where it has no opinion. They are weighed with the
            estimate of the field; walls thinner than `THIN_WALL` with observed free space on both
            sides, and hands that collide only with unobserved surface, are left to the network.

    Returns:
        The survivors, best first, with the number of candidates dropped for each `Rejection`. The
        score is the estimated probability that the grasp is truly valid; the ``id`` is the number
        of the candidate.

    Raises:
        GraspError: If poses, widths and priors do not match.
    """
    poses = np.asarray(X_OG)
    learned = np.full((len(poses), 2), [1.0, np.nan])
    if prior is not None:
        learned = np.asarray(prior)
        if not (np.isfinite(learned[:, 0]).all() and not np.isinf(learned[:, 1]).any()):
            raise GraspError(
                "filter_grasps: prior holds contacts without a probability, or infinity; only that "
                "of a free hand may be NaN"
            )
    candidates = GraspSet(poses, np.asarray(width), learned[:, 0], {}, np.arange(len(poses)))
    if len(candidates) == 0:
        return candidates

    opening = gripper.max_opening - 2 * MARGIN
    narrow = (candidates.width <= opening) & ~np.bool_(is_wider(*gpdf.seen(), opening))
    candidates = candidates.select(narrow, Rejection.TOO_WIDE)
    as_is, flipped = (
        above_table(gpdf, X, gripper) for X in (candidates.X_OG, candidates.X_OG @ FLIP)
    )
    turn = (~as_is & flipped)[:, None, None]
    turned = replace(candidates, X_OG=np.where(turn, candidates.X_OG @ FLIP, candidates.X_OG))
    candidates = turned.select(as_is | flipped, Rejection.HITS_TABLE)
    pairs, pair_of = _contact_pairs(candidates)
    thin = (pairs.width < THIN_WALL) & (prior is not None)
    thin[thin] = _is_wall(gpdf, pairs.select(np.flatnonzero(thin)))
    off, cosine = contact_state(gpdf, pairs)
    cosine = np.where(thin, -1.0, cosine)
    # A contact further than this from the surface touches nothing [m].
    tolerance = 0.005
    touching = np.where(thin, off.min(axis=0), off.max(axis=0)) <= tolerance
    for reason, good in (
        (Rejection.OFF_SURFACE, touching),
        (Rejection.NOTHING_BETWEEN, thin | _holding(gpdf, pairs)),
        (Rejection.NOT_ANTIPODAL, cosine <= max(COSINE_STEPS)),
    ):
        kept = good[pair_of]
        candidates, pair_of = candidates.select(kept, reason), pair_of[kept]

    free, certain = hand_freedom(gpdf, candidates, learned[candidates.id, 1], gripper, ENOUGH)
    certain, pair_of = certain[free], pair_of[free]
    candidates = candidates.select(free, Rejection.COLLIDES)

    for limit in COSINE_STEPS:
        if np.count_nonzero(cosine[pair_of] <= limit) >= ENOUGH:
            break
    opposed = cosine[pair_of] <= limit
    certain, pair_of = certain[opposed], pair_of[opposed]
    candidates = candidates.select(opposed, Rejection.NOT_ANTIPODAL)
    left, pair_of = np.unique(pair_of, return_inverse=True)
    pairs, pair_of = pairs.select(left), pair_of.reshape(-1)
    angles, deviations = (part[pair_of] for part in contact_evidence(gpdf, pairs))
    of_network = None if prior is None else candidates.score
    in_thin_wall = candidates.width < THIN_WALL
    score = certain * contact_probability(angles, deviations, of_network, in_thin_wall)
    return replace(candidates, score=score).select(np.argsort(-score, kind="stable"))


def _is_wall(gpdf: Gpdf, pairs: GraspSet) -> Mask:
    """Mask of contact pairs with observed free space beyond both; all if no free space is known."""
    if not gpdf.has_free_space:
        return np.ones(len(pairs), dtype=bool)
    beyond = 0.008 * pairs.X_OG[:, :3, 0]  # a finger is thicker [m]
    first, second = contacts(pairs)
    return np.asarray(~gpdf.possible(first - beyond) & ~gpdf.possible(second + beyond))


def _contact_pairs(grasps: GraspSet) -> tuple[GraspSet, Indices]:
    """One grasp per contact pair, and which of them each grasp belongs to.

    Grasps that differ in their approach only share their contacts, and what depends on contacts
    alone is the costly part.
    """
    line = np.column_stack([grasps.X_OG[:, :3, 3], grasps.X_OG[:, :3, 0], grasps.width])
    line = line.round(7) + 0.0  # no negative zeros, so that equal rows have equal bytes
    rows = line.view(np.dtype((np.void, line.itemsize * line.shape[1]))).reshape(-1)
    _, first, pair_of = np.unique(rows, return_index=True, return_inverse=True)
    return grasps.select(first), pair_of.reshape(-1)


def above_table(gpdf: Gpdf, X_OG: Array, gripper: Gripper) -> Mask:
    """Mask of poses (n, 4, 4) at which the open hand is above the field's table by `MARGIN`."""
    if gpdf.table is None:
        return np.ones(len(X_OG), dtype=bool)
    normal, offset = gpdf.table[:3], gpdf.table[3]
    hand = gripper.surface_points(gripper.max_opening)
    # Heights of points along the axes of every hand, and of their origins.
    height = np.einsum("j,nji,ki->nk", normal, X_OG[:, :3, :3], hand, optimize=True)
    return np.asarray(height.min(axis=1) + X_OG[:, :3, 3] @ normal + offset >= MARGIN)


def contact_state(gpdf: Gpdf, grasps: GraspSet) -> tuple[Array, Array]:
    """How far both contacts are off the surface, (2, n) [m], and the cosine of their normals, (n,).

    The worst (largest) of three cosines: between the two outward normals, and of either normal
    with the closing line. The latter two say whether both contacts lie in the friction cone; -1 is
    a perfect antipodal pair.
    """
    both = np.concatenate(contacts(grasps))
    distance, gradient = gpdf.distance_and_gradient(both)
    n1, n2 = unit_normals(gradient).reshape(2, -1, 3)
    b = grasps.X_OG[:, :3, 0]
    pair = np.einsum("ni,ni->n", n1, n2)
    at_first = np.einsum("ni,ni->n", n1, b)
    at_second = -np.einsum("ni,ni->n", n2, b)
    cosine = np.maximum(pair, np.maximum(at_first, at_second))
    return np.abs(distance).reshape(2, -1), cosine


def _holding(gpdf: Gpdf, pairs: GraspSet) -> Mask:
    """Whether some part of the line between the contacts is inside the object."""
    # So deep behind a contact is the inside of a wall [m].
    into_wall = 0.002
    middle, b, half = pairs.X_OG[:, :3, 3], pairs.X_OG[:, :3, 0], 0.5 * pairs.width
    holding = gpdf.distance(middle) < 0.0
    # Most are filled in the middle; of a cup there are the walls alone.
    for along in (0.6 * half, -0.6 * half, half - into_wall, into_wall - half):
        left = np.flatnonzero(~holding)
        holding[left] = gpdf.distance(middle[left] + along[left, None] * b[left]) < 0.0
    return holding


@checked(GraspError)
def is_wider(
    points: Annotated[Array, CLOUD], normals: Annotated[Array, CLOUD], opening: Positive
) -> bool:
    """Whether observed surface is convex, and wider than a hand's opening in every direction.

    Then no view of the rest makes it narrower. A bowl or a mug that is seen from above is not. The
    width of a hull, the least distance between two parallel planes with all points between, is
    taken over the planes of its faces (Houle & Toussaint, "Computing the width of a set", IEEE PAMI
    1988, where pairs of edges count, too: those are hardly closer here). Of points (n, 3) with
    outward unit normals.
    """
    most, off, share = 300, 5e-3, 0.97  # points; [m] below the hull, of so many of them
    points, normals = (each[:: 1 + len(each) // most] for each in (points, normals))
    if len(points) < 20 or (np.ptp(points, axis=0) <= opening).any():
        return False
    try:
        planes = ConvexHull(points).equations
    except QhullError:
        return False
    depth = -(points @ planes[:, :3].T + planes[:, 3])
    # On a face that looks where the surface does: the inside of a bowl is on its hull, too.
    outside = (depth <= off) & (normals @ planes[:, :3].T > 0.5)
    convex = np.mean(outside.any(axis=1)) >= share
    return bool(convex and depth.max(axis=0).min() > opening)
