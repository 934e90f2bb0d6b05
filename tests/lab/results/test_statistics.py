"""Intervals of proportions and means against published and hand-computed ones."""

from itertools import product

import numpy as np
import pytest

from feasigrasp_lab.results.statistics import (
    area_under_curve,
    mean,
    mean_of_objects,
    proportion,
    resampled,
    share_of_objects,
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


def runs_of_objects(rng, k, repeats, spread):
    """Runs whose objects differ by 1 and whose repeats by ``spread``, true mean 0."""
    values = rng.normal(size=k)[:, None] + spread * rng.normal(size=(k, repeats))
    return values.ravel(), np.repeat(np.arange(k), repeats).tolist()


@pytest.mark.parametrize("k", [6, 18])
def test_resampled_objects_cover_the_truth_and_resampled_runs_do_not(k):
    """With runs that hardly differ, an interval over runs is too narrow by the root of repeats."""
    rng = np.random.default_rng(0)
    hits = np.zeros(2)
    for _ in range(600):
        values, objects = runs_of_objects(rng, k, 6, 0.3)
        over_objects = mean_of_objects(values, objects)
        over_runs = mean(values)
        hits += [e.low <= 0.0 <= e.high for e in (over_objects, over_runs)]
    covered = hits / 600
    assert 0.92 <= covered[0] <= 0.975
    assert covered[1] < 0.7


def test_with_many_objects_the_interval_is_students_over_their_means():
    values, objects = runs_of_objects(np.random.default_rng(1), 300, 3, 0.5)
    found, expected = mean_of_objects(values, objects), mean(values.reshape(300, 3).mean(axis=1))
    half = expected.high - expected.value
    assert found.value == pytest.approx(expected.value)
    assert (found.low, found.high) == (
        pytest.approx(expected.low, abs=0.06 * half), pytest.approx(expected.high, abs=0.06 * half)
    )  # fmt: skip
    assert found.n == 900


def test_every_object_counts_once():
    """Ten runs of the one object count as much as one of the other: (1 + 4) / 2."""
    estimate = mean_of_objects([1.0] * 10 + [4.0], ["a"] * 10 + ["b"])
    assert (estimate.value, estimate.n) == (2.5, 11)
    # Two objects: nothing, or both draws, of either.
    assert (estimate.low, estimate.high) == (1.0, 4.0)
    assert mean_of_objects([4.0, 1.0, 1.0], ["b", "a", "a"]).value == 2.5


def test_objects_that_are_alike_give_a_point_and_one_object_students_interval():
    alike = mean_of_objects([0.1] * 6, list("aabbcc"))
    assert alike.low == pytest.approx(0.1) == alike.high and alike.low <= alike.value <= alike.high
    assert mean_of_objects([1.0, 2.0, 3.0], ["a"] * 3) == mean([1.0, 2.0, 3.0])
    assert mean_of_objects([1.0, 2.0], ["a"] * 2, lower=0.5).low == 0.5


def test_a_share_on_which_all_runs_agree_has_wilsons_interval_over_objects():
    objects = [name for name in "abcdefghij" for _ in range(6)]
    held, lost = share_of_objects([True] * 60, objects), share_of_objects([False] * 60, objects)
    assert (held.low, held.high, held.n) == (proportion(10, 10).low, 1.0, 60)
    assert (lost.low, lost.high, lost.n) == (0.0, proportion(0, 10).high, 60)
    assert share_of_objects([True, False], ["a", "a"]) == proportion(1, 2)


def share(failures, objects, repeats):
    """The share of ``objects`` with ``repeats`` runs, the first of which failed so many times."""
    failed = [*failures, *[0] * (objects - len(failures))]
    outcomes = [j >= n for n in failed for j in range(repeats)]
    return share_of_objects(outcomes, [k for k in range(objects) for _ in range(repeats)])


def test_two_failures_do_not_make_an_interval_narrower():
    """The case that was wrong: 24 of 24 objects gave 86 to 100 %, 142 of 144 runs 96 to 100 %."""
    none, one_object, two_objects = (share(f, 24, 6) for f in ([], [2], [1, 1]))
    assert none.low == pytest.approx(0.862, abs=1e-3)
    for some in (one_object, two_objects):
        assert some.low < none.low < some.value < some.high < 1.0
        assert some.high - some.low >= (none.high - none.low) * (1.0 - 1e-12)


def test_no_failure_makes_an_interval_narrower():
    """All outcomes of 18 objects with 3 runs each, by how many objects failed how many times."""
    found = {}
    for counts in product(range(19), repeat=3):
        if sum(counts) <= 18:
            outcome = (18 - sum(counts), *counts)
            found[outcome] = share(np.repeat(range(4), outcome)[::-1], 18, 3)
    assert len(found) == 1330
    for outcome, before in found.items():
        for n in range(3):
            if outcome[n]:
                more = list(outcome)
                more[n], more[n + 1] = more[n] - 1, more[n + 1] + 1
                after = found[tuple(more)]
                if after.value >= 0.5:  # below, more failures mean more agreement
                    assert after.high - after.low >= before.high - before.low - 1e-9
                    assert after.low <= before.low + 1e-9
        mirrored = found[outcome[::-1]]
        assert before.low == pytest.approx(1.0 - mirrored.high, abs=2e-9) or before.value == 0.5


@pytest.mark.parametrize("failures", [[1] * 18, [1] * 9, [2] * 18])
def test_where_objects_do_not_matter_a_share_has_wilsons_interval_over_runs(failures):
    found = share(failures, 18, 3)
    wilson = proportion(54 - sum(failures), 54)
    assert (found.low, found.high) == (pytest.approx(wilson.low), pytest.approx(wilson.high))


@pytest.mark.parametrize("failures", [[6] * 3, [6]])
def test_where_objects_decide_a_share_has_wilsons_interval_over_objects(failures):
    found, wilson = share(failures, 18, 6), proportion(18 - len(failures), 18)
    assert (found.low, found.high) == (pytest.approx(wilson.low), pytest.approx(wilson.high))


@pytest.mark.parametrize("truth", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("rho", [0.01, 0.3, 0.9])
def test_a_share_covers_the_truth_where_objects_differ(truth, rho):
    """Success probabilities of objects are drawn from a beta distribution of that correlation."""
    rng, hits = np.random.default_rng(2), 0
    scale, objects = 1.0 / rho - 1.0, np.repeat(np.arange(18), 6).tolist()
    for _ in range(1000):
        p = rng.beta(truth * scale, (1.0 - truth) * scale, 18)
        estimate = share_of_objects(rng.random(108) < np.repeat(p, 6), objects)
        hits += estimate.low <= truth <= estimate.high
    assert hits / 1000 >= 0.93


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


def test_interval_of_the_area_as_published():
    """Hanley and McNeil (1982), Radiology 143: area 0.893 of 51 and 58 images, error 0.032."""
    # 58 normal and 51 abnormal images, rated 1 to 5 (their table I).
    normal, abnormal = [33, 6, 6, 11, 2], [3, 2, 2, 11, 33]
    score = np.repeat([1, 2, 3, 4, 5] * 2, [*normal, *abnormal]).astype(float)
    positive = np.arange(109) >= 58
    estimate = area_under_curve(score, positive)
    assert estimate.value == pytest.approx(0.893, abs=5e-4)
    assert (estimate.high - estimate.value) / 1.959964 == pytest.approx(0.032, abs=5e-4)
