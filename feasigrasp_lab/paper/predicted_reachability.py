"""Grasps of a moving object that stay reachable over the prediction horizon."""

from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import HYSTERESIS
from feasigrasp.models.objects.prediction import Motion, future_poses
from feasigrasp.models.quantities import (
    ANY_POSES,
    TWIST,
    UNKNOWN_POSE,
    ArrayOf,
    Count,
    NotNegative,
    Share,
)
from feasigrasp.models.reach.feasible_grasps import JudgedGrasps, judged
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Verdict

#: A hand that reaches a pre-grasp pose at this distance also reaches the grasp [m]. Source:
#: guessed.
WAY_IN = 0.05
#: Instants of the horizon at which a grasp is judged, its end included. Source: guessed.
_INSTANTS = 4


@runtime_checkable
class Judge(Protocol):
    """Decides which hand poses the arm reaches; `Reachability` is exact."""

    def verdicts(self, X_WG: Annotated[ArrayLike, ANY_POSES]) -> NDArray[np.int8]:
        """Verdicts on hand poses (n, 4, 4) in the base frame, places in `VERDICTS`, shape (n,)."""


@checked(ReachabilityError)
def judge_grasps(
    grasps: GraspSet,
    X_WO: Annotated[Array, UNKNOWN_POSE],
    V_WO: Annotated[Array, TWIST],
    judge: Judge,
    horizon: NotNegative = 1.0,
    motion: Motion | None = None,
    *,
    n_best: Count = 24,
    score_share: Share = 0.6,
    symmetric_grasps: bool = True,
    way_in: NotNegative = 0.0,
    kept_before: Annotated[ArrayLike, ArrayOf(("k",), dtype=np.int64)] = (),
) -> JudgedGrasps:
    """Mask of grasps, flips included, that stay reachable for ``horizon`` seconds.

    Args:
        grasps: Grasps in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        judge: Decides which hand poses can be reached.
        horizon: Look-ahead [s]; 0 for none. A grasp is judged after each quarter of it.
        motion: Predicts the object's poses; without it, the object moves on with its twist.
        n_best: How many are kept at most, the best scores first.
        score_share: Grasps that score less than this share of the best one in reach are left out.
        symmetric_grasps: Whether the flip of a grasp counts as another; without, only the grasps
            given do.
        way_in: Grasps that the hand cannot stand back from by this much, along their approach
            direction, neither now nor within the horizon, are left out if there are others [m].
        kept_before: Ids of the grasps that were kept last; another takes the place of one of them
            only if it scores `HYSTERESIS` times as much.

    Returns:
        The grasps that are kept, their ``rejected`` counting the verdicts on the others, and the
        verdicts. Once enough grasps are kept, worse ones are not judged: "better grasps in reach".
    """
    both = grasps.with_symmetric() if symmetric_grasps else grasps
    known = np.isin(both.id, kept_before) & (both.id != UNKNOWN)
    order = np.argsort(-both.score * np.where(known, HYSTERESIS, 1.0), kind="stable")
    times = horizon * np.arange(1, _INSTANTS + 1) / _INSTANTS if horizon > 0.0 else np.zeros(0)
    X_later = future_poses(motion, X_WO, V_WO, times)
    verdicts = np.full(len(both), Verdict.BETTER, dtype=object)
    kept: list[int] = []
    # hand poses judged at first, best scores first; twice as many each time after
    start, size = 0, 32
    while start < len(order) and len(kept) < n_best:
        chunk = order[start : start + size]
        start, size = start + size, 2 * size
        now = judge.verdicts(X_WO @ both.X_OG[chunk])
        verdicts[chunk] = [VERDICTS[code] for code in now]
        reached = chunk[now == REACHABLE]
        stays = _stays_in_reach(both.X_OG[reached], X_later, judge)
        verdicts[reached] = np.where(
            stays, Verdict.BETTER, Verdict.SOON
        )  # until it is known which are kept
        kept.extend(reached[stays].tolist())
    kept = kept[:n_best]
    if kept and way_in > 0.0:
        back = both.X_OG[kept].copy()
        back[:, :3, 3] -= way_in * back[:, :3, 2]
        X_WG = np.concatenate([X_WO[None], X_later])[:, None] @ back
        reached = judge.verdicts(X_WG.reshape(-1, 4, 4)) == REACHABLE
        comes = reached.reshape(len(X_WG), -1).any(axis=0)
        if comes.any():
            verdicts[np.array(kept)[~comes]] = Verdict.NO_WAY_IN
            kept = [i for i, open_ in zip(kept, comes, strict=True) if open_]
    if kept:
        enough = score_share * both.score[kept].max()
        kept = [i for i in sorted(kept, key=lambda i: -both.score[i]) if both.score[i] >= enough]
    return judged(grasps, both, np.array(kept, dtype=int), verdicts)


def _stays_in_reach(X_OG: Array, X_later: Array, judge: Judge) -> Mask:
    """Which grasps (n, 4, 4) can be reached at all of the object's later poses (t, 4, 4)."""
    if len(X_OG) == 0 or len(X_later) == 0:
        return np.ones(len(X_OG), dtype=bool)
    X_WG = X_later[:, None] @ X_OG
    reached = judge.verdicts(X_WG.reshape(-1, 4, 4)) == REACHABLE
    return np.asarray(reached.reshape(len(X_later), len(X_OG)).all(axis=0))
