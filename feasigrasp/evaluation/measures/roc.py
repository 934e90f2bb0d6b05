"""How well a score tells two classes apart."""

from __future__ import annotations

import math

import numpy as np
from scipy.stats import norm, rankdata

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.results.statistics import CONFIDENCE, Estimate


def roc_curve(score: Array, positive: Mask) -> tuple[Array, Array]:
    """Shares of false and of true positives as the threshold falls, from (0, 0) to (1, 1).

    Args:
        score: Higher means more likely positive, shape (n,).
        positive: The truth, shape (n,).
    """
    order = np.argsort(-score, kind="stable")
    true = np.concatenate([[0.0], np.cumsum(positive[order])])
    false = np.concatenate([[0.0], np.cumsum(~positive[order])])
    # Between equal scores there is no threshold.
    keep = np.concatenate([[True], np.diff(score[order]) != 0.0, [True]])
    return false[keep] / max(false[-1], 1.0), true[keep] / max(true[-1], 1.0)


def area_under_curve(score: Array, positive: Mask) -> Estimate:
    """Probability that a positive scores higher than a negative; ties count half.

    The interval is that of Hanley and McNeil (1982), "The meaning and use of the area under a
    receiver operating characteristic (ROC) curve".

    Args:
        score: Shape (n,).
        positive: The truth, shape (n,), with at least one of each class.
    """
    n, m = int(positive.sum()), int((~positive).sum())
    area = float((rankdata(score)[positive].sum() - n * (n + 1) / 2) / (n * m))
    q1, q2 = area / (2.0 - area), 2.0 * area**2 / (1.0 + area)
    variance = area * (1.0 - area) + (n - 1) * (q1 - area**2) + (m - 1) * (q2 - area**2)
    half = float(norm.ppf(0.5 + 0.5 * CONFIDENCE)) * math.sqrt(max(variance, 0.0) / (n * m))
    return Estimate(area, max(area - half, 0.0), min(area + half, 1.0), n + m)
