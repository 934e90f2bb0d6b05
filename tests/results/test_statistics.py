"""Intervals of proportions and means against published and hand-computed ones."""

import numpy as np
import pytest

from feasigrasp.results.statistics import (
    area_under_curve,
    average_precision,
    mean,
    proportion,
    resampled,
    roc_curve,
)


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_as_published(successes, n, low, high):
    """Newcombe (1998), Statistics in Medicine 17, table I, method 3."""
    estimate = proportion(successes, n)
    assert estimate.value == pytest.approx(successes / n)
    assert (round(estimate.low, 4), round(estimate.high, 4)) == (low, high)


@pytest.mark.parametrize("n", [1, 2, 7, 36])
def test_wilson_interval_is_symmetric_and_holds_its_value(n):
    none, all_of_them = proportion(0, n), proportion(n, n)
    assert (none.low, all_of_them.high) == (0.0, 1.0)
    assert none.high == pytest.approx(1.0 - all_of_them.low)


def test_student_interval_of_three():
    """Mean 2, deviation 1: 2 +- 4.302653/sqrt(3), t_0.975 with 2 degrees of freedom."""
    estimate = mean([1.0, 2.0, 3.0])
    half = 4.302652729911275 / np.sqrt(3.0)
    assert (estimate.value, estimate.n) == (2.0, 3)
    np.testing.assert_allclose([estimate.low, estimate.high], [2.0 - half, 2.0 + half])
    cut = mean([1.0, 2.0, 3.0], lower=0.0, upper=4.0)
    assert (cut.low, cut.high) == (0.0, 4.0)
    assert mean([5.0]).low is None and mean([5.0]).high is None


def test_resampled_interval_of_a_mean_is_that_of_the_normal_distribution():
    x = np.random.default_rng(0).normal(3.0, 2.0, 400)
    estimate = resampled(list(x), lambda items: float(np.mean(items)))
    half = 1.959964 * x.std(ddof=1) / np.sqrt(len(x))
    assert (estimate.value, estimate.n) == (pytest.approx(x.mean()), 400)
    assert estimate.high - estimate.low == pytest.approx(2 * half, rel=0.15)
    assert estimate.low < estimate.value < estimate.high
    assert resampled([1.0], np.mean).low is None


def scores(n=60, m=90):
    rng = np.random.default_rng(1)
    positive = np.arange(n + m) < n
    return np.round(rng.normal(positive * 1.0, 1.0), 1), positive  # rounded: there are ties


def test_area_under_the_curve_counts_pairs():
    score, positive = scores()
    higher = score[positive][:, None] - score[~positive]
    expected = np.mean((higher > 0) + 0.5 * (higher == 0))
    assert area_under_curve(score, positive).value == pytest.approx(expected)
    false, true = roc_curve(score, positive)
    assert np.trapezoid(true, false) == pytest.approx(expected)
    assert (false[0], true[0], false[-1], true[-1]) == (0.0, 0.0, 1.0, 1.0)


def test_interval_of_the_area_as_published():
    """Hanley and McNeil (1982), Radiology 143: area 0.893 of 51 and 58 images, error 0.032."""
    # 58 normal and 51 abnormal images, rated 1 to 5 (their table I).
    normal, abnormal = [33, 6, 6, 11, 2], [3, 2, 2, 11, 33]
    score = np.repeat([1, 2, 3, 4, 5] * 2, [*normal, *abnormal]).astype(float)
    positive = np.arange(109) >= 58
    estimate = area_under_curve(score, positive)
    assert estimate.value == pytest.approx(0.893, abs=5e-4)
    assert (estimate.high - estimate.value) / 1.959964 == pytest.approx(0.032, abs=5e-4)


def test_average_precision_by_hand():
    """Positives at ranks 1, 3 and 4 of five: (1 + 2/3 + 3/4) / 3."""
    score, positive = np.array([5.0, 4.0, 3.0, 2.0, 1.0]), np.array([1, 0, 1, 1, 0], dtype=bool)
    assert average_precision(score, positive) == pytest.approx((1 + 2 / 3 + 3 / 4) / 3)
    assert np.isnan(average_precision(score, np.zeros(5, dtype=bool)))
