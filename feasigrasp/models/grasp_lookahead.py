"""Reachable grasps of a moving object: those that stay in reach for a while."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models import se3
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.reachability import Reachability

FloatArray = NDArray[np.float64]


def reachable_grasps(
    grasps: GraspSet,
    X_WO: FloatArray,
    V_WO: FloatArray,
    reachability: Reachability,
    horizon: float = 1.0,
    n_best: int = 24,
) -> GraspSet:
    """The grasps, flips included, that are reachable now and after ``horizon`` seconds.

    Args:
        grasps: Grasps in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Exact inverse kinematics of arm and hand.
        horizon: Look-ahead [s]; 0 for none.
        n_best: How many are kept, the best scores first.

    Returns:
        A subset in the object frame; ``rejected`` counts
        "out of reach now", "out of reach soon" and "better grasps in reach".
    """
    both = grasps.with_twins()
    now = both.select(reachability.reachable(X_WO @ both.X_OG), "out of reach now")
    if horizon > 0.0:
        X_later = se3.extrapolate(X_WO, V_WO, horizon)
        now = now.select(reachability.reachable(X_later @ now.X_OG), "out of reach soon")
    best = np.argsort(-now.score, kind="stable")[:n_best]
    return now.select(best, "better grasps in reach")
