"""Reachable grasps of a moving object: those that stay in reach for a while."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models import se3
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.reachability import Reachability

FloatArray = NDArray[np.float64]

_CHUNK = 32  # hand poses tried at once, best scores first, until enough can be reached


def reachable_grasps(
    grasps: GraspSet,
    X_WO: FloatArray,
    V_WO: FloatArray,
    reachability: Reachability,
    horizon: float = 1.0,
    n_best: int = 24,
    score_share: float = 0.6,
) -> GraspSet:
    """The grasps, flips included, that are reachable now and after ``horizon`` seconds.

    Args:
        grasps: Grasps in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Exact inverse kinematics of arm and hand.
        horizon: Look-ahead [s]; 0 for none.
        n_best: How many are kept at most, the best scores first.
        score_share: Grasps that score less than this share of the best one in reach are left out.

    Returns:
        A subset in the object frame; ``rejected`` counts
        "out of reach now", "out of reach soon" and "better grasps in reach".
    """
    best_first = grasps.with_twins()
    best_first = best_first.select(np.argsort(-best_first.score, kind="stable"))
    X_later = se3.extrapolate(X_WO, V_WO, horizon)
    kept: list[int] = []
    rejected = {"out of reach now": 0, "out of reach soon": 0, "better grasps in reach": 0}
    for start in range(0, len(best_first), _CHUNK):
        X_OG = best_first.X_OG[start : start + _CHUNK]
        if len(kept) >= n_best:
            rejected["better grasps in reach"] += len(X_OG)
            continue
        now = reachability.reachable(X_WO @ X_OG)
        both = now.copy()
        if horizon > 0.0:
            both[now] = reachability.reachable(X_later @ X_OG[now])
        kept.extend((start + np.flatnonzero(both)).tolist())
        rejected["out of reach now"] += int(np.sum(~now))
        rejected["out of reach soon"] += int(np.sum(now & ~both))
    rejected["better grasps in reach"] += max(0, len(kept) - n_best)
    kept = kept[:n_best]
    if kept:
        enough = score_share * best_first.score[kept[0]]
        good = [i for i in kept if best_first.score[i] >= enough]
        rejected["better grasps in reach"] += len(kept) - len(good)
        kept = good
    chosen = best_first.select(np.array(kept, dtype=int))
    counts = Counter(grasps.rejected)
    counts.update({reason: count for reason, count in rejected.items() if count > 0})
    return GraspSet(chosen.X_OG, chosen.width, chosen.score, counts)
