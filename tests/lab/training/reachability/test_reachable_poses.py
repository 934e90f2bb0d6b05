"""Sampled poses are reached, admissible, reproducible, and thinned as promised."""

import numpy as np

from feasigrasp.models.reach.kernels import REACHABLE, WRIST
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability
from feasigrasp_lab.training import fit_reachability as reachable_poses
from feasigrasp_lab.training.fit_reachability import (
    FLOOR,
    manipulability_reference,
    sample_reachable_poses,
)


def sample(n, seed=0, **options):
    return sample_reachable_poses(n, np.random.default_rng(seed), **options)


def test_every_pose_is_reached_by_exact_inverse_kinematics():
    X, _ = sample(3000)
    # Solutions at the edge of reach are few: arm angles lie between the ones that are tried.
    judge = Reachability(n_arm_angles=180, limit_margin=-1e-3, clearance=-1e-3, table_height=-9.0)
    verdicts = judge.flange_verdicts(X)
    assert (verdicts == REACHABLE).mean() > 0.998
    assert (verdicts == WRIST).sum() == 0


def test_counts_add_up_and_the_floor_holds():
    X, counts = sample(5000, thin=0.1)
    assert counts["drawn"] == 5000
    assert (
        len(X)
        == counts["reached"]
        == 5000 - sum(counts[n] for n in ("colliding", "low", "thinned"))
    )
    assert min(counts.values()) > 0
    assert X[:, 2, 3].min() >= FLOOR > 0.0


def test_thinning_keeps_in_proportion_to_manipulability(monkeypatch):
    reference = 0.1
    rng = np.random.default_rng(1)
    q = IIWA_7.random_positions(rng, 40_000)
    expected = np.minimum(manipulability(q) / reference, 1.0).mean()
    monkeypatch.setattr(reachable_poses, "FLOOR", -9.0)
    _, counts = sample(40_000, thin=reference)
    kept = counts["reached"] / (counts["reached"] + counts["thinned"])
    np.testing.assert_allclose(kept, expected, atol=0.01)


def test_one_draw_in_ten_is_above_the_reference():
    q = IIWA_7.random_positions(np.random.default_rng(6), 20_000)
    above = (manipulability(q) > manipulability_reference()).mean()
    np.testing.assert_allclose(above, 0.1, atol=0.01)


def test_samples_depend_on_the_seed_alone():
    a, b, c = (sample(300, seed=seed)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a[:5], c[:5])
