"""Which grasps are kept, and the reasons that are counted for the others."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.reach.feasible_grasps import feasible_grasps
from feasigrasp.models.reach.interception import (
    InterceptionOptions,
    Situation,
    find_interceptions,
)
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict

REACH, OPTIONS = Reachability(), InterceptionOptions()
Q, STILL = np.array([0.0, 0.2, 0.0, -1.4, 0.0, 1.2, 0.0]), np.zeros(6)
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
MOST, STILL_ARM = 32, np.zeros(7)


@pytest.fixture(scope="module")
def grasps():
    """All round the object, many of them out of reach."""
    rng = np.random.default_rng(0)
    X_OG = se3.random_pose(rng, 60)
    X_OG[:, :3, 3] *= 0.05
    return GraspSet(X_OG, np.full(60, 0.05), rng.random(60), {"no contact": 5}, id=np.arange(60))


def judged(grasps, V_WO=STILL, *, X_WO=X_WO, q=Q, v=None, options=OPTIONS, **settings):
    now = Situation(0.0, q, np.zeros(7) if v is None else v, X_WO, V_WO)
    return feasible_grasps(grasps, now, REACH, options, **settings)


def costs(grasps, V_WO=STILL, q=Q, v=STILL_ARM):
    """Costs of the grasps and their flips."""
    both, now = grasps.with_symmetric(), Situation(0.0, q, v, X_WO, V_WO)
    return find_interceptions(both.X_OG, both.score, now, REACH, OPTIONS).cost


def rows(X):
    return {tuple(x.ravel().round(9)) for x in X}


def test_of_a_resting_object_only_grasps_in_reach_are_kept(grasps):
    both = grasps.with_symmetric()
    reach = REACH.reachable(X_WO @ both.X_OG)
    assert 10 < reach.sum() < len(both) - 10
    kept = judged(grasps).grasps
    assert REACH.reachable(X_WO @ kept.X_OG).all()
    assert rows(kept.X_OG) <= rows(both.X_OG[reach])
    assert len(kept) > 10
    assert kept.rejected["no contact"] == 5


def test_every_grasp_and_flip_has_a_verdict_and_is_counted(grasps):
    behind = grasps.with_symmetric().X_OG.copy()
    behind[:, :3, 3] -= OPTIONS.way_in * behind[:, :3, 2]
    comes = REACH.reachable(X_WO @ behind)
    for V_WO in (STILL, np.array([0.0, 0.0, 0.8, 0.2, 0.1, 0.0])):
        found = judged(grasps, V_WO)
        both, cost = grasps.with_symmetric(), costs(grasps, V_WO)
        exact = REACH.verdicts(X_WO @ both.X_OG)
        assert len(found.verdicts) == len(both)
        kept = rows(found.grasps.X_OG)
        for k, verdict in enumerate(found.verdicts):
            assert (verdict == Verdict.KEPT) == (tuple(both.X_OG[k].ravel().round(9)) in kept)
            if np.isfinite(cost[k]):
                assert verdict in (Verdict.KEPT, Verdict.BETTER)
            elif VERDICTS[exact[k]] == Verdict.REACHABLE:
                assert verdict == (Verdict.SOON if comes[k] else Verdict.NO_WAY_IN)
            else:
                assert verdict == VERDICTS[exact[k]]
        counts = Counter(found.verdicts)
        assert counts.pop(Verdict.KEPT) == len(found.grasps)
        assert found.grasps.rejected == {"no contact": 5, **counts}
        assert len(counts) >= 3


def test_those_kept_cost_least_and_the_first_is_the_best(grasps):
    cost = costs(grasps)
    assert np.isfinite(cost).sum() > MOST
    kept, both = judged(grasps).grasps, grasps.with_symmetric()
    best = np.argsort(cost, kind="stable")[:MOST]
    np.testing.assert_array_equal(kept.X_OG, both.X_OG[best])
    np.testing.assert_array_equal(kept.score, both.score[best])
    np.testing.assert_array_equal(kept.id, both.id[best])


def test_flips_count_only_if_they_are_asked_for(grasps):
    found = judged(grasps, symmetric_grasps=False)
    assert len(found.verdicts) == len(grasps)
    assert rows(found.grasps.X_OG) <= rows(grasps.X_OG)
    # With them it does not matter which way round grasps are given.
    flip = replace(grasps, X_OG=grasps.X_OG @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    assert rows(judged(grasps).grasps.X_OG) == rows(judged(flip).grasps.X_OG)


def test_an_object_that_leaves_loses_the_grasps_that_leave_reach(grasps):
    """Whatever is kept is met somewhere on the path and goes on being in reach there."""
    V_WO = np.array([0.0, 0.0, 0.3, 0.3, 0.0, 0.0])
    still, away = judged(grasps), judged(grasps, V_WO)
    assert len(away.grasps) > 0
    assert away.grasps.rejected[Verdict.SOON] > 0
    assert Verdict.SOON not in still.verdicts
    now = Situation(0.0, Q, np.zeros(7), X_WO, V_WO)
    found = find_interceptions(away.grasps.X_OG, away.grasps.score, now, REACH, OPTIONS)
    for X_OG, arrival in zip(away.grasps.X_OG, found.arrival, strict=True):
        for ahead in (arrival, arrival + OPTIONS.step):
            assert REACH.reachable((se3.extrapolate(X_WO, V_WO, ahead) @ X_OG)[None]).all()


@pytest.mark.parametrize("speed", [5.0, 20.0])
def test_an_object_that_flies_away_keeps_none(grasps, speed):
    found = judged(grasps, np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0]))
    assert len(found.grasps) == 0
    assert Verdict.SOON in found.verdicts


def test_those_that_were_kept_stay_unless_others_are_clearly_better(grasps):
    """By half a second: one that costs less than 0.5 s more than the last one kept stays."""
    bad = np.where(np.arange(60) < 20, 0.05, grasps.score)
    grasps = replace(grasps, score=bad)
    cost, both = costs(grasps), grasps.with_symmetric()
    order = np.argsort(cost, kind="stable")
    last, others = cost[order[MOST - 1]], order[MOST : np.isfinite(cost).sum()]
    before_last = cost[order[MOST - 2]]  # its flip was kept as well, and may come in
    near, far = others[cost[others] < before_last + 0.5], others[cost[others] > last + 0.5]
    assert len(near) > 3 and len(far) > 0
    for some, stays in ((near, True), (far, False)):
        for k in some:
            kept = judged(grasps, kept_before=np.array([both.id[k]])).grasps
            assert (tuple(both.X_OG[k].ravel().round(9)) in rows(kept.X_OG)) == stays
    plain = judged(grasps).grasps
    # One that no earlier set was compared with was not there before.
    unknown = replace(grasps, id=np.full(len(grasps), UNKNOWN))
    again = judged(unknown, kept_before=np.array([UNKNOWN])).grasps
    np.testing.assert_array_equal(again.X_OG, plain.X_OG)


def test_it_is_told_which_grasps_there_are_in_reach_or_not(grasps):
    some = replace(grasps, id=10 + np.arange(len(grasps)))
    kept = judged(some).grasps
    np.testing.assert_array_equal(kept.on_object, some.id)
    assert set(kept.id) < set(some.id)


@pytest.mark.parametrize("V_WO", [STILL, np.full(6, np.nan)], ids=["known", "unknown"])
def test_no_grasps(V_WO):
    found = judged(GraspSet.empty({"all": 3}), V_WO)
    assert len(found.grasps) == 0 and found.verdicts == ()
    assert found.grasps.rejected == {"all": 3}


LOST = [
    {"X_WO": np.full((4, 4), np.nan)},
    {"X_WO": np.where(np.eye(4) == 1.0, 1.0, np.nan)},
    {"V_WO": np.full(6, np.nan)},
    {"V_WO": np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])},
    {"X_WO": se3.make_pose(np.eye(3), [3.0, 0.0, 0.5])},
]


@pytest.mark.parametrize("lost", LOST, ids=["pose", "some of it", "twist", "some", "far"])
def test_of_an_object_that_is_unknown_or_far_no_grasp_is_kept(grasps, lost):
    found = judged(grasps, **lost)
    assert len(found.grasps) == 0
    assert set(found.verdicts) == {Verdict.WRIST}
    assert found.grasps.rejected == {"no contact": 5, Verdict.WRIST: 2 * len(grasps)}
    np.testing.assert_array_equal(found.grasps.on_object, grasps.id)


def test_what_is_met_depends_on_where_the_arm_is_and_how_it_moves(grasps):
    """A quick object is met best by an arm that is not far from its path."""
    V_WO = np.array([0.0, 0.0, 0.0, 0.0, 0.6, 0.0])
    ahead, behind = Q.copy(), Q.copy()
    ahead[0], behind[0] = 0.6, -2.0
    counts = [np.isfinite(costs(grasps, V_WO, q)).sum() for q in (ahead, behind)]
    assert counts[0] > 2 * counts[1]
    assert len(judged(grasps, V_WO, q=ahead).grasps) == min(counts[0], MOST)
    # One that swings the other way has to turn back first.
    slow = 0.5 * V_WO
    away, there = (
        np.sort(costs(grasps, slow, behind, v * np.eye(7)[0]))[:5].mean() for v in (-1.4, 1.4)
    )
    assert there + 0.1 < away < np.inf


def test_scores_count_as_the_options_say(grasps):
    plain = replace(OPTIONS, score=0.0)
    with_scores, without = judged(grasps).grasps, judged(grasps, options=plain).grasps
    assert with_scores.score.mean() > without.score.mean()
