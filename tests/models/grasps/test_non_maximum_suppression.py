"""Which grasps are offered: different ones, likely ones, and few rather than poor ones."""

import numpy as np
import pytest

from feasigrasp.models.grasps.grasp_set import ENOUGH, GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import (
    distinct,
    suppress_non_maxima,
)


def scored(*scores):
    """Grasps 10 cm apart, best first."""
    X_OG = np.tile(np.eye(4), (len(scores), 1, 1))
    X_OG[:, 0, 3] = 0.1 * np.arange(len(scores))
    return GraspSet(X_OG, np.full(len(scores), 0.04), np.array(scores, dtype=float))


@pytest.mark.parametrize(
    ("scores", "left"),
    [
        ([0.95] * 4 + [0.7] * 8, ENOUGH),  # likely ones fill up to ten
        ([0.95] * 12 + [0.7] * 4, 12),  # enough without them
        ([0.95] * 2 + [0.3] * 6, 2),  # fewer rather than worse
        ([0.4, 0.3], 1),  # the best of the bad, since there is no other
    ],
)
def test_few_rather_than_poor(scores, left):
    distinct_grasps = suppress_non_maxima(scored(*scores), 64)
    np.testing.assert_array_equal(distinct_grasps.score, scores[:left])
    assert distinct_grasps.rejected.get("uncertain", 0) == len(scores) - left


def test_whoever_judges_further_gets_all():
    assert len(suppress_non_maxima(scored(0.9, 0.4, 0.1), 64, least_score=0.0)) == 3


def test_of_none_there_is_none():
    assert len(distinct(scored(0.9, 0.8), 0)) == 0 and len(distinct(scored(0.9, 0.8), 1)) == 1


def test_near_copies_go_first():
    twice = scored(0.9, 0.8).joined(scored(0.7, 0.6))
    distinct_grasps = suppress_non_maxima(twice, 64, least_score=0.0)
    np.testing.assert_array_equal(distinct_grasps.score, [0.9, 0.8])
    assert dict(distinct_grasps.rejected) == {"near copy": 2}
