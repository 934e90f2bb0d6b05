"""Post-filter of parallel-jaw grasps against a completed surface.

Choi & Figueroa (arXiv 2311.02576, "Data-driven grasp sampler"): gripper points must lie outside
the surface, and the normals at the two contacts must oppose each other. Here the second contact is
``c2 = c1 + w b`` with b pointing from c1 into the object; the authors' script forgets the
translation in that look-up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models.gpdf import Gpdf
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.gripper import ParallelGripper

Array = NDArray[np.float64]

#: Cosines between opposed contact normals that are tried one after the other.
COSINE_STEPS = (-0.95, -0.9, -0.8, -0.7)
#: A contact further than this from the surface touches nothing [m].
CONTACT_TOLERANCE = 0.005
#: Least distance of the open hand from the completed surface [m].
MARGIN = 0.003
#: Lever arm from the object's centre to the contact line at which the score has dropped to 1/e [m].
LEVER_LENGTH = 0.05
#: Distance from the nearest observed point at which certainty has dropped to 1/e [m].
UNSEEN_LENGTH = 0.02


def filter_grasps(
    gpdf: Gpdf,
    X_OG: ArrayLike,
    width: ArrayLike,
    gripper: ParallelGripper,
    *,
    margin: float = MARGIN,
    cosine_steps: Sequence[float] = COSINE_STEPS,
    enough: int = 10,
) -> GraspSet:
    """Keeps the grasps that fit the hand, hold the object and collide with nothing.

    Args:
        gpdf: Distance field in frame O.
        X_OG: Candidate grasp frames, shape (n, 4, 4).
        width: Distance between the contacts, shape (n,) [m].
        gripper: The hand; it approaches fully open.
        margin: Least distance of the open hand from the surface, and of either pad on its side
            of the object [m].
        cosine_steps: Largest cosine allowed between the contact normals, strictest first. A
            weaker one is used only while fewer than ``enough`` grasps pass.
        enough: See ``cosine_steps``.

    Returns:
        The survivors, best first, with the number of candidates dropped for each reason: "too
        wide", "off the surface", "nothing between the pads", "not antipodal", "gripper collides".

    Raises:
        GraspError: If poses and widths do not match.
    """
    poses = np.array(X_OG, dtype=float).reshape(-1, 4, 4)
    candidates = GraspSet(poses, np.array(width, dtype=float), np.zeros(len(poses)))
    if len(candidates) == 0:
        return candidates

    candidates = candidates.select(candidates.width <= gripper.max_opening - 2 * margin, "too wide")
    pairs, pair_of = _contact_pairs(candidates)
    on_surface, holding = _touching(gpdf, pairs), _holding(gpdf, pairs)
    cosine = contact_cosine(gpdf, pairs)
    checks = {
        "off the surface": on_surface[pair_of],
        "nothing between the pads": holding[pair_of],
        "not antipodal": (cosine <= max(cosine_steps))[pair_of],
    }
    candidates, pair_of = _apply(candidates, pair_of, checks)
    hand = gripper.surface_points(gripper.max_opening)
    free = ~gpdf.touches(candidates.X_OG, hand, margin)
    candidates, pair_of = _apply(candidates, pair_of, {"gripper collides": free})

    for limit in sorted(cosine_steps):
        if np.count_nonzero(cosine[pair_of] <= limit) >= enough:
            break
    opposed = cosine[pair_of] <= limit
    candidates, pair_of = _apply(candidates, pair_of, {"not antipodal": opposed})
    left, pair_of = np.unique(pair_of, return_inverse=True)
    score = _score(gpdf, pairs.select(left), cosine[left])[pair_of]
    ranked = GraspSet(candidates.X_OG, candidates.width, score, candidates.rejected)
    return ranked.select(np.argsort(-score, kind="stable"))


def contacts(grasps: GraspSet) -> tuple[Array, Array]:
    """The two contact points ``c1`` and ``c2 = c1 + w b`` of each grasp, shapes (n, 3), in O."""
    half = 0.5 * grasps.width[:, None] * grasps.X_OG[:, :3, 0]
    middle = grasps.X_OG[:, :3, 3]
    return middle - half, middle + half


def contact_cosine(gpdf: Gpdf, grasps: GraspSet) -> Array:
    """How well the contacts oppose each other: -1 is a perfect antipodal pair, shape (n,).

    The worst (largest) of three cosines: between the two outward normals, and of either normal
    with the closing line. The latter two say whether both contacts lie in the friction cone.
    """
    first, second = contacts(grasps)
    n1, n2, b = gpdf.normals(first), gpdf.normals(second), grasps.X_OG[:, :3, 0]
    pair = np.einsum("ni,ni->n", n1, n2)
    at_first = np.einsum("ni,ni->n", n1, b)
    at_second = -np.einsum("ni,ni->n", n2, b)
    return np.maximum(pair, np.maximum(at_first, at_second))


def _contact_pairs(grasps: GraspSet) -> tuple[GraspSet, NDArray[np.intp]]:
    """One grasp per contact pair, and which of them each grasp belongs to.

    Grasps that differ in their approach only share their contacts, and what depends on contacts
    alone is the costly part.
    """
    line = np.column_stack([grasps.X_OG[:, :3, 3], grasps.X_OG[:, :3, 0], grasps.width])
    _, first, pair_of = np.unique(line.round(7), axis=0, return_index=True, return_inverse=True)
    return grasps.select(first), pair_of.reshape(-1)


def _apply(
    grasps: GraspSet, pair_of: NDArray[np.intp], checks: Mapping[str, NDArray[np.bool_]]
) -> tuple[GraspSet, NDArray[np.intp]]:
    """Drops the grasps that fail; each is counted under the first check that it fails."""
    passed = np.ones(len(grasps), dtype=bool)
    for reason, check in checks.items():
        grasps, check = grasps.select(check[passed], reason), check & passed
        passed = check
    return grasps, pair_of[passed]


def _touching(gpdf: Gpdf, pairs: GraspSet) -> NDArray[np.bool_]:
    """Whether both contacts lie on the completed surface."""
    first, second = contacts(pairs)
    off = np.maximum(np.abs(gpdf.distance(first)), np.abs(gpdf.distance(second)))
    return off <= CONTACT_TOLERANCE


def _holding(gpdf: Gpdf, pairs: GraspSet) -> NDArray[np.bool_]:
    """Whether some part of the line between the contacts is inside the object."""
    first, second = contacts(pairs)
    share = np.array([0.2, 0.5, 0.8])[None, :, None]
    between = first[:, None] + share * (second - first)[:, None]
    return gpdf.distance(between.reshape(-1, 3)).reshape(-1, 3).min(axis=1) < 0.0


def _score(gpdf: Gpdf, grasps: GraspSet, cosine: Array) -> Array:
    """Opposition, short lever arm and certainty of the contacts as one number in [0, 1].

    A product, so that none makes up for another: a firm grip far from the centre still slips.
    """
    first, second = contacts(grasps)
    to_centre = gpdf.completion.points.mean(axis=0) - grasps.X_OG[:, :3, 3]
    lever = np.linalg.norm(np.cross(to_centre, grasps.X_OG[:, :3, 0]), axis=1)
    unseen = np.maximum(gpdf.variance(first), gpdf.variance(second))
    # At a distance rho from the nearest observed point the variance is about 2 rho / l.
    rho = 0.5 * gpdf.length_scale * unseen
    opposition = np.clip(-cosine, 0.0, 1.0)
    certainty = 0.5 + 0.5 * np.exp(-rho / UNSEEN_LENGTH)
    return opposition * np.exp(-lever / LEVER_LENGTH) * certainty
