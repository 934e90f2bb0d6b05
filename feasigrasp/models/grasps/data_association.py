"""Data association of grasps between consecutive fields, by the Hungarian method (Kuhn 1955).

Every new view gives a new distance field and new grasps, most of them the old ones moved by a
millimetre. Whoever follows a grasp needs to know that, and the grasp should stay where it is: one
that is still good is kept as it was, and a new one takes its place only if it is clearly better.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from feasigrasp.models.arrays import Frozen, Indices
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection
from feasigrasp.models.grasps.hand_clearance import THIN_WALL
from feasigrasp.models.grasps.non_maximum_suppression import distinct, grasp_distance
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf

#: By which factor a new grasp has to score higher than an old one beside it, to replace it.
HYSTERESIS = 1.25
_NO_MATCH = 1e3


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
        count: int | None = None,
    ) -> GraspHistory:
        """The history after one more field.

        Args:
            gpdf: The new field.
            found: The grasps sampled from it, best first.
            recheck: Which of the old grasps are still good on the new field, rescored; ids as
                before. Without it none is kept, and the new ones are given the ids of the old.
            count: Most grasps kept; as many as were found or were there before by default.

        Returns:
            Old grasps that are still good, as they were, unless a clearly better one is beside
            them, and what was found besides; best first.
        """
        old = self.grasps
        count = max(len(old), len(found)) if count is None else count
        if count == 0:
            return GraspHistory(gpdf, found, self.next_id)
        ids = np.full(len(found), -1, dtype=np.int64)
        matched_old, matched_new = associate_grasps(old, found)
        ids[matched_new] = old.id[matched_old]

        good = GraspSet.empty() if recheck is None or not len(old) else recheck(gpdf, old)
        before = dict(zip(old.id.tolist(), old.score, strict=True))
        fresh = dict(zip(ids.tolist(), found.score, strict=True))
        score = np.array(
            [min(now, before[i]) for i, now in zip(good.id.tolist(), good.score, strict=True)]
        )
        beside = np.array([fresh.get(i, 0.0) for i in good.id.tolist()])
        stays = beside <= HYSTERESIS * score
        kept = replace(good, score=np.maximum(score, beside)).select(stays)

        new = replace(found, id=ids).select(~np.isin(ids, kept.id))
        numbers = new.id.copy()
        unknown = numbers < 0
        numbers[unknown] = self.next_id + np.arange(np.count_nonzero(unknown))
        grasps = _merged(kept, replace(new, id=numbers), count)
        return GraspHistory(gpdf, grasps, self.next_id + int(np.count_nonzero(unknown)))


def associate_grasps(first: GraspSet, second: GraspSet) -> tuple[Indices, Indices]:
    """Association of two grasp sets, one to one.

    The assignment of the least total distance within the tolerance of near copies; a grasp and its
    180-degree flip about z are the same.

    Returns:
        Indices into the first and into the second set, shape (k,) each.
    """
    if len(first) == 0 or len(second) == 0:
        nothing = np.zeros(0, dtype=np.intp)
        return nothing, nothing
    distance = grasp_distance(first, second)
    rows, columns = linear_sum_assignment(np.where(distance <= 1.0, distance, _NO_MATCH))
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
    known = np.sqrt(walls.score)
    passed = (
        (thick, filter_grasps(gpdf, thick.X_OG, thick.width, gripper)),
        (
            walls,
            filter_grasps(
                gpdf, walls.X_OG, walls.width, gripper, prior=np.column_stack([known, known])
            ),
        ),
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
