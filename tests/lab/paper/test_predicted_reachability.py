"""Which grasps are kept, and the reasons that are counted for the others."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.reach.reachability import VERDICTS, Reachability
from feasigrasp_lab.paper.judge import PoseJudge
from feasigrasp_lab.paper.predicted_reachability import judge_grasps

REACHABILITY = Reachability()
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
STILL = np.zeros(6)


@pytest.fixture(scope="module")
def grasps():
    """All round the object, many of them out of reach."""
    rng = np.random.default_rng(0)
    X_OG = se3.random_pose(rng, 60)
    X_OG[:, :3, 3] *= 0.05
    return GraspSet(X_OG, np.full(60, 0.05), rng.random(60), {"no contact": 5})


def rows(X):
    return {tuple(x.ravel().round(9)) for x in X}


def test_without_look_ahead_they_are_those_in_reach(grasps):
    both = grasps.with_symmetric()
    reach = REACHABILITY.reachable(X_WO @ both.X_OG)
    assert 10 < reach.sum() < len(both) - 10
    kept = judge_grasps(
        grasps,
        X_WO,
        STILL,
        REACHABILITY,
        horizon=0.0,
        n_best=1000,
        score_share=0.0,
    ).grasps
    np.testing.assert_array_equal(np.sort(kept.score), np.sort(both.score[reach]))
    assert rows(kept.X_OG) == rows(both.X_OG[reach])
    out = {k: n for k, n in kept.rejected.items() if k in VERDICTS[:5]}
    assert sum(out.values()) == (~reach).sum() and len(out) >= 2
    assert kept.rejected["no contact"] == 5
    assert "out of reach soon" not in kept.rejected


def test_a_still_object_loses_nothing_by_looking_ahead(grasps):
    now = judge_grasps(grasps, X_WO, STILL, REACHABILITY, horizon=0.0).grasps
    soon = judge_grasps(grasps, X_WO, STILL, REACHABILITY, horizon=1.0).grasps
    np.testing.assert_array_equal(soon.X_OG, now.X_OG)


def test_an_object_that_leaves_loses_the_grasps_that_leave_reach(grasps):
    V_WO = np.array([0.0, 0.0, 0.4, 0.15, 0.0, 0.0])
    kept = judge_grasps(
        grasps,
        X_WO,
        V_WO,
        REACHABILITY,
        horizon=1.0,
        n_best=1000,
        score_share=0.0,
    ).grasps
    now = judge_grasps(
        grasps,
        X_WO,
        V_WO,
        REACHABILITY,
        horizon=0.0,
        n_best=1000,
        score_share=0.0,
    ).grasps
    X_later = X_WO.copy()
    X_later[:3, :3] = se3.so3_exp([0, 0, 0.4])
    X_later[0, 3] += 0.15
    later = REACHABILITY.reachable(X_later @ now.X_OG)
    for t in (0.25, 0.5, 0.75):
        later &= REACHABILITY.reachable(se3.extrapolate(X_WO, V_WO, t) @ now.X_OG)
    assert 0 < later.sum() < len(now)
    assert rows(kept.X_OG) == rows(now.X_OG[later])
    assert kept.rejected["out of reach soon"] == (~later).sum()
    both = len(grasps.with_symmetric())
    assert len(kept) + sum(kept.rejected.values()) == both + grasps.rejected["no contact"]


def test_an_object_that_flies_away_keeps_none(grasps):
    V_WO = np.array([0, 0, 0, 5.0, 0.0, 0.0])
    assert len(judge_grasps(grasps, X_WO, V_WO, REACHABILITY).grasps) == 0


def test_of_too_many_the_best_are_kept(grasps):
    every = judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=1000, score_share=0.0).grasps
    best = judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=7, score_share=0.0).grasps
    np.testing.assert_array_equal(best.score, np.sort(every.score)[::-1][:7])
    # Not every one of the others was asked for; every one is counted all the same.
    assert best.rejected["better grasps in reach"] >= len(every) - 7
    assert len(best) + sum(best.rejected.values()) == len(every) + sum(every.rejected.values())


def test_those_that_were_kept_stay_unless_others_are_clearly_better(grasps):
    ids = np.arange(len(grasps))
    every = judge_grasps(
        replace(grasps, id=ids),
        X_WO,
        STILL,
        REACHABILITY,
        n_best=1000,
        score_share=0.0,
    ).grasps
    before = np.unique(every.id[len(every) // 2 :])[:4]  # none of the best

    def kept(factor):
        score = np.where(np.isin(ids, before), factor * 0.8, 0.8)
        some = replace(grasps, id=ids, score=score)
        return judge_grasps(
            *(some, X_WO, STILL, REACHABILITY),
            kept_before=before,
            n_best=len(before),
            score_share=0.0,
        ).grasps

    beside, below = kept(0.9), kept(0.7)
    assert set(beside.id) <= set(before) and len(beside) == len(before)
    assert not set(below.id) & set(before) and len(below) == len(before)
    # One that no earlier set was compared with was not there before.
    unknown = replace(grasps, id=np.full(len(grasps), UNKNOWN))
    again = judge_grasps(
        unknown,
        X_WO,
        STILL,
        REACHABILITY,
        kept_before=np.array([UNKNOWN]),
        n_best=5,
    )
    plain = judge_grasps(unknown, X_WO, STILL, REACHABILITY, n_best=5)
    np.testing.assert_array_equal(again.grasps.X_OG, plain.grasps.X_OG)


def test_it_is_told_which_grasps_there_are_in_reach_or_not(grasps):
    some = replace(grasps, id=10 + np.arange(len(grasps)))
    judged = judge_grasps(some, X_WO, STILL, REACHABILITY, n_best=3).grasps
    np.testing.assert_array_equal(judged.on_object, some.id)
    assert set(judged.id) < set(some.id)


def test_grasps_far_below_the_best_are_left_out(grasps):
    every = judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=1000, score_share=0.0).grasps
    good = judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=1000, score_share=0.5).grasps
    best = every.score.max()
    assert 0 < len(good) < len(every)
    np.testing.assert_array_equal(good.score, every.score[every.score >= 0.5 * best])


def test_no_grasps():
    kept = judge_grasps(GraspSet.empty({"all": 3}), X_WO, STILL, REACHABILITY).grasps
    assert len(kept) == 0 and kept.rejected == {"all": 3}


def test_a_grasp_must_stay_in_reach_all_the_way(grasps):
    """The object turns once about itself within the horizon: it ends where it starts."""
    V_WO = np.array([0.0, 0.0, 2 * np.pi, 0.0, 0.0, 0.0])
    full = judge_grasps(grasps, X_WO, V_WO, REACHABILITY, n_best=1000, score_share=0.0).grasps
    still = judge_grasps(grasps, X_WO, STILL, REACHABILITY, n_best=1000, score_share=0.0).grasps
    assert len(full) < len(still)
    for X in full.X_OG:
        for angle in (0.5 * np.pi, np.pi, 1.5 * np.pi):
            turned = se3.make_pose(X_WO[:3, :3] @ se3.so3_exp([0, 0, angle]), X_WO[:3, 3])
            assert REACHABILITY.reachable(turned @ X)[0]


def test_every_grasp_and_flip_has_a_verdict(grasps):
    judged = judge_grasps(grasps, X_WO, STILL, PoseJudge(REACHABILITY), n_best=10)
    both = grasps.with_symmetric()
    exact = [VERDICTS[k] for k in REACHABILITY.verdicts(X_WO @ both.X_OG)]
    assert len(judged.verdicts) == len(both)
    kept = rows(judged.grasps.X_OG)
    for X, verdict, truth in zip(both.X_OG, judged.verdicts, exact, strict=True):
        assert (verdict == "kept") == (tuple(X.ravel().round(9)) in kept)
        if verdict not in ("kept", "better grasps in reach"):
            assert verdict == truth
    assert judged.verdicts.count("kept") == len(judged.grasps) == 10


def test_grasps_without_a_way_in_are_left_out_where_others_have_one(grasps):
    def judged(some, way_in):
        return judge_grasps(
            *(some, X_WO, STILL, REACHABILITY),
            horizon=0.0,
            n_best=1000,
            score_share=0.0,
            way_in=way_in,
        )

    every = judged(grasps, 0.0).grasps
    back = every.X_OG.copy()
    back[:, :3, 3] -= 0.1 * back[:, :3, 2]
    comes = REACHABILITY.reachable(X_WO @ back)
    assert 5 < comes.sum() < len(comes) - 5
    kept = judged(grasps, 0.1)
    assert rows(kept.grasps.X_OG) == rows(every.X_OG[comes])
    assert kept.grasps.rejected["no way in"] == (~comes).sum()
    assert kept.verdicts.count("no way in") == (~comes).sum()
    # Better one that cannot be come by than none: the hand may find another way.
    blocked = judged(every.select(np.flatnonzero(~comes)[:1]), 0.1).grasps
    assert len(blocked) >= 1
