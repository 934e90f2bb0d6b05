"""Grasps of a moving object that the arm can intercept and follow."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.quantities import ArrayOf
from feasigrasp.models.reach.interception import InterceptionOptions, Situation, find_interceptions
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict

#: Most grasps that are kept: what a controller ranks anew in 4 ms. Source: guessed.
MOST = 32
#: A grasp takes the place of one that was kept if it saves this [s]: more than a controller asks
#: for (`HorizonOptions.switch`), so that no grasp leaves the set before the controller leaves it.
#: Source: guessed.
_KEPT = 0.5


@dataclass(frozen=True, eq=False)
class JudgedGrasps(Frozen):
    """The grasps in reach, and what became of every one.

    Attributes:
        grasps: Those that are kept, in the object frame, the best first; their ``on_object`` has
            the ids of all that were given.
        verdicts: A `Verdict` on every grasp given, then on the 180-degree flip of every grasp, if
            those count.
    """

    grasps: GraspSet
    verdicts: tuple[str, ...] = ()


def judged(grasps: GraspSet, both: GraspSet, kept: Indices, verdicts: Array) -> JudgedGrasps:
    """Of grasps and their flips, ``both``, those kept, in order, with verdicts on the others."""
    verdicts[kept] = Verdict.KEPT
    counts = Counter(reason for reason in verdicts if reason != Verdict.KEPT)
    chosen = both.select(kept).counted(counts)
    return JudgedGrasps(replace(chosen, on_object=grasps.id), tuple(verdicts.tolist()))


@checked(ReachabilityError)
def feasible_grasps(
    grasps: GraspSet,
    now: Situation,
    reachability: Reachability,
    options: InterceptionOptions,
    *,
    symmetric_grasps: bool = True,
    kept_before: Annotated[ArrayLike, ArrayOf(("k",), dtype=np.int64)] = (),
) -> JudgedGrasps:
    """The grasps, flips included, that cost least to intercept and follow.

    One that is never intercepted has the verdict of its present pose; where that is in reach, "no
    way in" if the pose behind it is not, else "out of reach soon". One that costs too much has
    "better grasps in reach".

    Args:
        grasps: Grasps in the object frame.
        now: Arm and object.
        reachability: Hand, limits and clearances.
        options: Instants, limits and weights.
        symmetric_grasps: Whether the flip of a grasp counts as another.
        kept_before: Ids of the grasps that were kept last.

    Raises:
        ReachabilityError: An argument of another type or shape.
    """
    both = grasps.with_symmetric() if symmetric_grasps else grasps
    if len(both) == 0 or not now.known:
        verdicts = np.full(len(both), Verdict.WRIST, dtype=object)
        return judged(grasps, both, np.zeros(0, dtype=int), verdicts)
    cost = find_interceptions(both.X_OG, both.score, now, reachability, options).cost
    cost = cost - _KEPT * (np.isin(both.id, kept_before) & (both.id != UNKNOWN))
    order = np.argsort(cost, kind="stable")
    verdicts = np.full(len(both), Verdict.BETTER, dtype=object)
    lost = np.flatnonzero(~np.isfinite(cost))
    verdicts[lost] = reasons(now.X_WO @ both.X_OG[lost], reachability, options.way_in)
    return judged(grasps, both, order[: min(MOST, len(both) - len(lost))], verdicts)


def reasons(X_WG: Array, reachability: Reachability, way_in: float) -> list[Verdict]:
    """Verdicts on grasps at present poses (n, 4, 4) that are never intercepted."""
    behind = X_WG.copy()
    behind[:, :3, 3] -= way_in * behind[:, :3, 2]
    codes, comes = reachability.verdicts(X_WG), reachability.reachable(behind)
    in_reach = [Verdict.SOON if each else Verdict.NO_WAY_IN for each in comes]
    return [VERDICTS[c] if c != REACHABLE else v for c, v in zip(codes, in_reach, strict=True)]
