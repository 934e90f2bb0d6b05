"""Near copies of grasps: non-maximum suppression, data association between fields."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import ENOUGH, UNKNOWN, GraspSet, Rejection
from feasigrasp.models.grasps.hand_clearance import THIN_WALL
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf

#: Grasps closer than this to a better one are copies of it [m], [rad]. Source: guessed.
SAME_POSITION, SAME_ANGLE = 0.010, np.deg2rad(20.0)
#: Grasps that score less are left out, as long as `ENOUGH` are there; those less likely than even
#: are offered only if there is no other. Source: guessed.
LEAST_SCORE, EVEN = 0.87, 0.5


def suppress_non_maxima(
    grasps: GraspSet, count: int, *, least_score: float = LEAST_SCORE
) -> GraspSet:
    """At most ``count`` of the best grasps that differ from each other, best first.

    Grasps that score less than ``least_score`` are left out, unless fewer than `ENOUGH` are left:
    then likely ones fill up, as far as there are any. What is dropped counts as "near copy" or
    "uncertain".
    """
    kept = grasps.select(distinct(grasps, count), Rejection.NEAR_COPY)
    certain = kept.score >= least_score
    certain[:ENOUGH] |= kept.score[:ENOUGH] >= EVEN
    certain[:1] = True
    return kept.select(certain, Rejection.UNCERTAIN)


def filter_by_score(grasps: GraspSet, least: float) -> GraspSet:
    """Grasps above a share of `EVEN` odds; others count as "uncertain"."""
    return grasps.select(np.flatnonzero(grasps.score >= least * EVEN), Rejection.UNCERTAIN)


def distinct(grasps: GraspSet, count: int) -> Indices:
    """Indices of at most ``count`` grasps, in their order, none a near copy of an earlier one."""
    chosen = np.empty(count, dtype=np.int64)
    return chosen[: _distinct_kernel(grasps.X_OG, chosen)]


def grasp_distance(first: GraspSet, second: GraspSet) -> Array:
    """Distances between grasps in units of what counts as a near copy, shape (n, m).

    Position and angle as the root of their squares; of a grasp and its flip the nearer one.
    """
    return _distances_kernel(first.X_OG, second.X_OG)


@compiled
def _distances_kernel(X_OA, X_OB):
    distances = np.empty((len(X_OA), len(X_OB)))
    for i in range(len(X_OA)):
        for j in range(len(X_OB)):
            distances[i, j] = np.sqrt(_square_distance(X_OA[i], X_OB[j]))
    return distances


@compiled
def _square_distance(X_OA, X_OB):
    """The square of `grasp_distance`; a grasp and its flip about z are the same."""
    square, xx, yy, zz = 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        square += (X_OA[k, 3] - X_OB[k, 3]) ** 2
        xx += X_OA[k, 0] * X_OB[k, 0]
        yy += X_OA[k, 1] * X_OB[k, 1]
        zz += X_OA[k, 2] * X_OB[k, 2]
    angle = np.arccos(min(1.0, max(-1.0, (abs(xx + yy) + zz - 1.0) / 2.0)))
    return square / SAME_POSITION**2 + (angle / SAME_ANGLE) ** 2


@compiled
def _distinct_kernel(X_OG, chosen):
    """Writes the indices and returns their number."""
    n = 0
    for i in range(len(X_OG) if len(chosen) else 0):
        copy = False
        for j in chosen[:n]:
            if _square_distance(X_OG[i], X_OG[j]) <= 1.0:
                copy = True
                break
        if not copy:
            chosen[n] = i
            n += 1
            if n == len(chosen):
                break
    return n


# Data association of grasps between consecutive fields: a new view gives a new field and new
# grasps, most of them the old ones moved by a millimetre. A hand keeps to the one that it follows.

#: By which factor a new grasp has to score higher than an old one beside it, to replace it. Source:
#: guessed.
HYSTERESIS = 1.25


@dataclass(frozen=True, eq=False)
class GraspHistory(Frozen):
    """Grasps of the latest field with ids that persist between fields.

    Attributes:
        gpdf: The field that the grasps belong to; None before the first.
        grasps: Its grasps.
        next_id: The id of the next grasp that was not there before.
    """

    gpdf: Gpdf | None = None
    grasps: GraspSet = field(default_factory=GraspSet.empty)
    next_id: int = 0

    def followed_by(
        self,
        gpdf: Gpdf,
        found: GraspSet,
        recheck: Callable[[Gpdf, GraspSet], GraspSet] | None = None,
    ) -> "GraspHistory":
        """The history after one more field, and the grasps sampled from it, best first.

        Old grasps that are still good stay as they were, unless a clearly better one is beside
        them; what was found besides joins them, up to the number of the larger set. ``recheck``
        says which are still good on the new field, rescored and with their ids. Without it none is
        kept, and the new ones are given the ids of the old.
        """
        old = self.grasps
        count = max(len(old), len(found))
        if count == 0:
            return GraspHistory(gpdf, found, self.next_id)
        matched_old, matched_new = associate_grasps(old, found)
        ids = np.full(len(found), UNKNOWN)
        ids[matched_new] = old.id[matched_old]
        unknown = ids == UNKNOWN
        next_id = self.next_id + int(np.count_nonzero(unknown))
        ids[unknown] = np.arange(self.next_id, next_id)

        good = recheck(gpdf, old) if recheck and len(old) else GraspSet.empty()
        before = dict(zip(old.id.tolist(), old.score, strict=True))
        fresh = dict(zip(ids.tolist(), found.score, strict=True))
        score = np.array(
            [min(now, before[i]) for i, now in zip(good.id.tolist(), good.score, strict=True)]
        )
        beside = np.array([fresh.get(i, 0.0) for i in good.id.tolist()])
        stays = beside <= HYSTERESIS * score
        kept = replace(good, score=np.maximum(score, beside)).select(stays)

        new = replace(found, id=ids).select(~np.isin(ids, kept.id))
        return GraspHistory(gpdf, _merged(kept, new, count), next_id)


def associate_grasps(first: GraspSet, second: GraspSet) -> tuple[Indices, Indices]:
    """Association of two grasp sets, one to one, by the Hungarian method (Kuhn 1955).

    The assignment of the least total distance within the tolerance of near copies: indices into the
    first and into the second set, shape (k,) each.
    """
    distance = grasp_distance(first, second)
    # Cost of a pair that does not match, beyond any other. Source: numerical.
    rows, columns = linear_sum_assignment(np.where(distance <= 1.0, distance, 1e3))
    same = distance[rows, columns] <= 1.0
    return rows[same], columns[same]


def recheck_grasps(gpdf: Gpdf, grasps: GraspSet, gripper: ParallelGripper) -> GraspSet:
    """The grasps that pass the filter on another field, with their ids and new scores.

    At thin walls the field decides neither whether contacts oppose each other nor whether a finger
    has room behind them (`filter_grasps`): there the score, a product of both probabilities, says
    what was known.
    """
    thin = grasps.width < THIN_WALL
    thick, walls = grasps.select(~thin), grasps.select(thin)
    known = np.repeat(np.sqrt(walls.score)[:, None], 2, axis=1)
    passed = (
        (thick, filter_grasps(gpdf, thick.X_OG, thick.width, gripper)),
        (walls, filter_grasps(gpdf, walls.X_OG, walls.width, gripper, prior=known)),
    )
    first, second = (replace(good, id=old.id[good.id]) for old, good in passed)
    both = first.joined(second)
    return both.select(np.argsort(-both.score, kind="stable"))


def _merged(kept: GraspSet, new: GraspSet, count: int) -> GraspSet:
    """Both sets as one, best first; beside each other an old grasp wins over a new one."""
    both = replace(kept, rejected=new.rejected).joined(new)
    preference = both.score * np.repeat([HYSTERESIS, 1.0], [len(kept), len(new)])
    both = both.select(np.argsort(-preference, kind="stable"))
    distinct_grasps = both.select(distinct(both, count), Rejection.NEAR_COPY)
    return distinct_grasps.select(np.argsort(-distinct_grasps.score, kind="stable"))
