"""Statistics of repeated runs and of scores, with confidence intervals."""

import math
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm, rankdata, t

from feasigrasp.models.arrays import Array, Mask

#: Confidence of intervals. Source: definition.
CONFIDENCE = 0.95
#: Quantile of the standard normal distribution with that confidence. Source: formula.
_Z = float(norm.ppf(0.5 + 0.5 * CONFIDENCE))

Item = TypeVar("Item")
Key = TypeVar("Key", bound=Hashable)


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


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Items by their keys, both in the order in which they come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def proportion(successes: int, n: int) -> Estimate:
    """A share of independent runs in [0, 1], with Wilson's score interval.

    Wilson (1927), "Probable inference, the law of succession, and statistical inference"; it stays
    sensible at 0 and 1, where the normal approximation shrinks to a point.

    Args:
        successes: Number of successes.
        n: Number of runs; the share of none is 0, without an interval.
    """
    if n == 0:
        return Estimate(0.0, None, None, 0)
    return Estimate(successes / n, *_wilson(successes / n, n), n)


def mean(values: ArrayLike, lower: float = -math.inf, upper: float = math.inf) -> Estimate:
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


def mean_of_objects(
    values: ArrayLike,
    objects: Sequence[Hashable],
    lower: float = -math.inf,
    upper: float = math.inf,
) -> Estimate:
    """The mean over objects of each one's mean, with the interval of drawing the objects anew.

    Runs with the same object are no independent ones: what is drawn are objects, with all their
    runs. The percentiles are the expanded ones of Hesterberg (2015), "What teachers should know
    about the bootstrap", section 5.3: plain ones are too narrow for few objects. Runs of a single
    object have Student's interval, which says nothing about other objects.

    Args:
        values: One figure per run, at least one.
        objects: The object of each.
        lower: Smallest possible value of the figure, for a single object.
        upper: Largest possible value.
    """
    x = np.asarray(values, dtype=float)
    index = _numbered(objects)
    k = int(index.max()) + 1
    if k < 2:
        return mean(x, lower, upper)
    means = np.bincount(index, x) / np.bincount(index)
    drawn = _shares_of_draws(k) @ means
    tail = float(norm.cdf(t.ppf(0.5 - 0.5 * CONFIDENCE, k - 1) * math.sqrt(k / (k - 1))))
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    value = float(means.mean())
    # Rounding must not leave the mean outside its own interval where all objects are alike.
    return Estimate(value, min(value, float(low)), max(value, float(high)), len(x))


def share_of_objects(outcomes: ArrayLike, objects: Sequence[Hashable]) -> Estimate:
    """A share of runs in [0, 1]: the mean over objects of each one's share.

    Its interval is Wilson's with the effective number of runs, n / (1 + (m - 1) rho) for m runs of
    each object (Saha, Miller and Wang, 2016, "A comparison of some approximate confidence intervals
    for a single proportion for clustered binary outcome data"). The intra-object correlation rho is
    that of the analysis of variance, at least 0, and 1 where all runs agree. rho has a lower bound:
    the interval is as wide as that of each outcome whose rarer results are a part of these, those
    of the worst objects. Another failure thus never makes it narrower. Runs of a single object
    count as independent.

    Args:
        outcomes: True or false per run, at least one.
        objects: The object of each.
    """
    true, index = np.asarray(outcomes, dtype=bool), _numbered(objects)
    runs, successes = np.bincount(index).astype(float), np.bincount(index, true)
    if len(runs) < 2:
        return proportion(int(true.sum()), len(true))
    share = float(np.mean(successes / runs))
    rarer = successes if share < 0.5 else runs - successes
    worst = np.argsort(-rarer / runs, kind="stable")
    n, width = 0.0, 0.0
    for failed in range(len(runs) + 1):
        part = np.where(np.isin(np.arange(len(runs)), worst[:failed]), rarer, 0.0)
        n = _effective_runs(part, runs)
        low, high = _wilson(float(np.mean(part / runs)), n)
        width = max(width, high - low)
    return Estimate(share, *_wilson(share, min(n, _runs_of_width(share, width))), len(true))


def _effective_runs(successes: Array, runs: Array) -> float:
    """The number of independent runs with as much information, by successes and runs of objects."""
    k, n = len(runs), float(runs.sum())
    if n == k:
        return n
    shares = successes / runs
    between = runs @ (shares - successes.sum() / n) ** 2 / (k - 1)
    within = runs @ (shares * (1.0 - shares)) / (n - k)
    size = (n - runs @ runs / n) / (k - 1)  # runs of each object, by the analysis of variance
    total = between + (size - 1.0) * within
    rho = max(0.0, (between - within) / total) if total > 0.0 else 1.0
    return float(n / (1.0 + (runs @ runs / n - 1.0) * rho))


def _wilson(share: float, n: float) -> tuple[float, float]:
    """Wilson's interval of a share of ``n`` runs, which need not be a whole number."""
    u = _Z**2 / n
    half = math.sqrt(share * (1.0 - share) * u + 0.25 * u**2) / (1.0 + u)
    center = (share + 0.5 * u) / (1.0 + u)
    # Rounding must not leave the share outside its own interval at 0 and 1.
    return max(0.0, min(share, center - half)), min(1.0, max(share, center + half))


def _runs_of_width(share: float, width: float) -> float:
    """The number of runs with which `_wilson` has that width: a quadratic equation."""
    b = 2.0 * share * (1.0 - share) - width**2
    return _Z**2 * (1.0 - width**2) / (math.sqrt(b**2 + (1.0 - width**2) * width**2) - b)


def _numbered(objects: Sequence[Hashable]) -> Array:
    """The number of each object, in the order in which they come, shape (n,)."""
    number: dict[Hashable, int] = {}
    return np.array([number.setdefault(each, len(number)) for each in objects])


@cache
def _shares_of_draws(k: int) -> Array:
    """How much of each draw of k objects every object is, shape (draws, k)."""
    # Draws of objects for a mean: they cost next to nothing there.
    return np.random.default_rng(k).multinomial(k, np.full(k, 1.0 / k), 10_000) / k


def resampled(items: Sequence[Item], statistic: Callable[[Sequence[Item]], float]) -> Estimate:
    """A statistic of items (objects), with the interval that resampling the items gives."""
    rng = np.random.default_rng(0)
    value, n = statistic(items), len(items)
    if n < 2:
        return Estimate(value, None, None, n)
    # Resamples of the bootstrap. Source: guessed.
    drawn = [statistic([items[i] for i in rng.integers(0, n, n)]) for _ in range(500)]
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.nanpercentile(drawn, [tail, 100.0 - tail])
    return Estimate(value, float(low), float(high), n)


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
    half = _Z * math.sqrt(max(variance, 0.0) / (n * m))
    return Estimate(area, max(area - half, 0.0), min(area + half, 1.0), n + m)
