"""Non-maximum suppression and score filter for grasps."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.grasps.grasp_set import GraspSet, Rejection

#: Grasps closer than this to a better one are copies of it.
SAME_POSITION, SAME_ANGLE = 0.010, np.deg2rad(20.0)
#: Grasps that score less are left out, as long as `ENOUGH` are there; those less likely than even
#: are offered only if there is no other.
LEAST_SCORE, ENOUGH, EVEN = 0.87, 10, 0.5


def suppress_non_maxima(
    grasps: GraspSet, count: int, *, least_score: float = LEAST_SCORE, enough: int = ENOUGH
) -> GraspSet:
    """The best grasps that differ from each other.

    Args:
        grasps: Best first.
        count: Most grasps wanted.
        least_score: Grasps that score less are left out ...
        enough: ... unless fewer than this many are left: then likely ones fill up, as far as there
            are any.

    Returns:
        Best first; what is dropped counts as "near copy" or "uncertain".
    """
    kept = grasps.select(distinct(grasps, count), Rejection.NEAR_COPY)
    certain = kept.score >= least_score
    certain[:enough] |= kept.score[:enough] >= EVEN
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
    for i in range(len(X_OG)):
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
