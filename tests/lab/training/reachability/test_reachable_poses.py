"""Sampled poses are reached, admissible, reproducible, and thinned as promised."""

import numpy as np

from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.kernels import REACHABLE, WRIST
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability
from feasigrasp_lab.training import fit_reachability as reachable_poses
from feasigrasp_lab.training.fit_reachability import (
    FLOOR,
    join,
    manipulability_reference,
    sample_reachable_poses,
)


def sample(n, seed=0, **options):
    return sample_reachable_poses(n, np.random.default_rng(seed), **options)


def poses(reached):
    return se3.make_pose(se3.rotations(reached.quaternions.astype(float)), reached.positions)


def test_every_pose_is_reached_by_exact_inverse_kinematics():
    X = poses(sample(3000))
    # Single precision can carry a pose at the very edge of reach over it; so can arm angles
    # between the ones that are tried.
    judge = Reachability(n_arm_angles=180, limit_margin=-1e-3, clearance=-1e-3, table_height=-9.0)
    verdicts = judge.flange_verdicts(X)
    assert (verdicts == REACHABLE).mean() > 0.998
    assert (verdicts == WRIST).sum() == 0


def test_counts_add_up_and_the_floor_holds():
    reached = sample(5000, thin=0.1)
    assert reached.drawn == 5000
    assert len(reached.positions) == 5000 - reached.colliding - reached.low - reached.thinned
    assert min(reached.colliding, reached.low, reached.thinned) > 0
    assert reached.positions[:, 2].min() >= FLOOR > 0.0


def test_thinning_keeps_in_proportion_to_manipulability(monkeypatch):
    reference = 0.1
    rng = np.random.default_rng(1)
    q = IIWA_7.random_positions(rng, 40_000)
    expected = np.minimum(manipulability(q) / reference, 1.0).mean()
    monkeypatch.setattr(reachable_poses, "FLOOR", -9.0)
    thinned = sample(40_000, thin=reference)
    kept = len(thinned.positions) / (len(thinned.positions) + thinned.thinned)
    np.testing.assert_allclose(kept, expected, atol=0.01)


def test_one_draw_in_ten_is_above_the_reference():
    q = IIWA_7.random_positions(np.random.default_rng(6), 20_000)
    above = (manipulability(q) > manipulability_reference()).mean()
    np.testing.assert_allclose(above, 0.1, atol=0.01)


def test_samples_depend_on_the_seed_alone():
    a, b, c = sample(300), sample(300), sample(300, seed=1)
    np.testing.assert_array_equal(a.positions, b.positions)
    assert not np.array_equal(a.positions[:5], c.positions[:5])
    both = join([a, c])
    assert both.drawn == 600
    assert len(both.quaternions) == len(a.quaternions) + len(c.quaternions)
