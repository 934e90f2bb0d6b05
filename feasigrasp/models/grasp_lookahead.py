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
) -> GraspSet:
    """The grasps, flips included, that are reachable now and after ``horizon`` seconds.

    Args:
        grasps: Grasps in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Exact inverse kinematics of arm and hand.
        horizon: Look-ahead [s]; 0 for none.

    Returns:
        A subset in the object frame; ``rejected`` counts "out of reach now" and "out of reach soon".
    """
    both = grasps.with_twins()
    if len(both) == 0:
        return both
    now = both.select(reachability.reachable(X_WO @ both.X_OG), "out of reach now")
    if len(now) == 0 or horizon <= 0.0:
        return now
    X_later = se3.extrapolate(X_WO, V_WO, horizon)
    return now.select(reachability.reachable(X_later @ now.X_OG), "out of reach soon")
