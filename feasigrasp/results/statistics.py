"""Intervals for what repeated runs show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, t

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval.

    Attributes:
        value: The figure.
        low: Lower end of the interval; None if one run cannot give one.
        high: Upper end.
        n: Number of runs behind it.
    """

    value: float
    low: float | None
    high: float | None
    n: int


def proportion(successes: int, n: int) -> Estimate:
    """A share of runs in [0, 1], with Wilson's score interval.

    Wilson (1927), "Probable inference, the law of succession, and statistical inference"; it stays
    sensible at 0 and 1, where the normal approximation shrinks to a point.

    Args:
        successes: Number of successes.
        n: Number of runs, at least 1.
    """
    z = float(norm.ppf(0.5 + 0.5 * CONFIDENCE))
    share = successes / n
    center = (share + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    # Rounding must not leave the estimate outside its own interval at 0 and 1.
    return Estimate(share, min(share, max(0.0, center - half)), max(share, center + half), n)


def mean(values: Sequence[float], lower: float = -math.inf, upper: float = math.inf) -> Estimate:
    """The mean of runs, with Student's t interval.

    Args:
        values: One figure per run, at least one.
        lower: Smallest possible value of the figure; the interval is cut there.
        upper: Largest possible value.
    """
    x = np.asarray(values, dtype=float)
    average = float(x.mean())
    if len(x) < 2:
        return Estimate(average, None, None, len(x))
    half = float(t.ppf(0.5 + 0.5 * CONFIDENCE, len(x) - 1) * x.std(ddof=1) / math.sqrt(len(x)))
    return Estimate(average, max(average - half, lower), min(average + half, upper), len(x))
