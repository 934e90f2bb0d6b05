"""Intervals of proportions and means against published and hand-computed ones."""

import numpy as np
import pytest

from feasigrasp.results.statistics import mean, proportion


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
