"""How a hand follows grasps: when it arrives, for how long it stays, when it takes another one."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3

#: A grasp is tracked while the hand is closer to it than this [m], [rad].
TRACKED_POSITION, TRACKED_ANGLE = 0.015, np.deg2rad(8.0)
#: The share of time tracked is counted after this time [s]: before, the arm is on its way.
SETTLED_AFTER = 2.0
#: The hand has settled if it tracks a grasp this long without a break [s].
SETTLED_FOR = 0.5
#: A hand that moves on the object farther than this [m], [rad] has taken another grasp; less is
#: the same grasp, known better after another view.
SAME_POSITION, SAME_ANGLE = 0.03, np.deg2rad(30.0)


def tracking_metrics(
    position_error: Array,
    angle_error: Array,
    X_OH: Array,
    following: Mask,
    period: float,
) -> dict[str, float | None]:
    """Figures of the samples in which the hand follows the object with open fingers.

    Args:
        position_error: Distance to the nearest grasp [m], NaN without grasps, shape (n,).
        angle_error: Angle to that grasp [rad], shape (n,).
        X_OH: Pose of the hand on the object, shape (n, 4, 4) [m].
        following: Samples that count: before the fingers close, shape (n,).
        period: Time between samples [s].

    Returns:
        ``tracked_percent``: share of the following samples after `SETTLED_AFTER` in which a grasp
        is tracked; None without such samples. ``settling_time_s``: when the hand first settled;
        None if it never did; a hand that closes its fingers before `SETTLED_FOR` is over has
        settled too. ``grasp_switches``: how often it settled at another grasp than before.
    """
    tracked = following & (position_error < TRACKED_POSITION) & (angle_error < TRACKED_ANGLE)
    late = following & (np.arange(len(tracked)) * period >= SETTLED_AFTER)
    needed = max(1, round(SETTLED_FOR / period))
    first, switches, taken = None, 0, None
    for start, end in _spells(tracked):
        closed = end < len(tracked) and not following[end]
        if end - start < needed and not closed:
            continue
        if first is None:
            first = start * period
        for i in range(start, end):
            if taken is None or not _same(X_OH[taken], X_OH[i]):
                switches += taken is not None
                taken = i
    return {
        "tracked_percent": 100.0 * float(np.mean(tracked[late])) if late.any() else None,
        "settling_time_s": first,
        "grasp_switches": float(switches),
    }


def _spells(true: Mask) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _same(X_OA: Array, X_OB: Array) -> bool:
    X_AB = se3.inverse(X_OA) @ X_OB
    moved = float(np.linalg.norm(X_AB[:3, 3]))
    return moved < SAME_POSITION and float(se3.rotation_angle(X_AB[:3, :3])) < SAME_ANGLE
