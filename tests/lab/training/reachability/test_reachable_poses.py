"""Sampled poses are reached, admissible, reproducible, and thinned as promised."""

import numpy as np
import pytest

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.kernels import REACHABLE, WRIST
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.training.reachability.plant_arm import SerialChain
from feasigrasp_lab.training.reachability.reachable_poses import (
    IiwaArm,
    join,
    manipulability_reference,
    sample_reachable_poses,
)


def sample(n, seed=0, **options):
    return sample_reachable_poses(IiwaArm(), n, np.random.default_rng(seed), **options)


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
    reached = sample(5000, floor=0.4, thin=0.1)
    assert reached.drawn == 5000
    assert len(reached.positions) == 5000 - reached.colliding - reached.low - reached.thinned
    assert min(reached.colliding, reached.low, reached.thinned) > 0
    assert reached.positions[:, 2].min() >= 0.4


def test_a_tool_is_a_right_multiplication():
    X_FT = ParallelGripper().X_FG
    flange, tool = sample(500, floor=-9.0), sample(500, floor=-9.0, X_FT=X_FT)
    np.testing.assert_allclose(poses(flange) @ X_FT, poses(tool), atol=1e-6)


def test_thinning_keeps_in_proportion_to_manipulability():
    arm, reference = IiwaArm(), 0.1
    rng = np.random.default_rng(1)
    q = IIWA_7.random_positions(rng, 40_000)
    expected = np.minimum(arm.manipulability(q) / reference, 1.0).mean()
    thinned = sample(40_000, thin=reference, floor=-9.0)
    kept = len(thinned.positions) / (len(thinned.positions) + thinned.thinned)
    np.testing.assert_allclose(kept, expected, atol=0.01)


def test_one_draw_in_ten_is_above_the_reference():
    arm = IiwaArm()
    q = np.random.default_rng(6).uniform(arm.lower, arm.upper, (20_000, 7))
    above = (arm.manipulability(q) > manipulability_reference(arm)).mean()
    np.testing.assert_allclose(above, 0.1, atol=0.01)


def test_samples_depend_on_the_seed_alone():
    a, b, c = sample(300), sample(300), sample(300, seed=1)
    np.testing.assert_array_equal(a.positions, b.positions)
    assert not np.array_equal(a.positions[:5], c.positions[:5])
    both = join([a, c])
    assert both.drawn == 600
    assert len(both.quaternions) == len(a.quaternions) + len(c.quaternions)


def planar_arm(**changes):
    """Two turning joints and a slide in the plane z = 0, by hand."""
    X = np.tile(np.eye(4), (3, 1, 1))
    X[1, 0, 3] = 0.4
    end = np.eye(4)
    end[0, 3] = 0.1
    values = {
        "X_PJ": X,
        "axes": np.array([[0, 0, 1.0], [0, 0, 1.0], [1.0, 0, 0]]),
        "prismatic": np.array([False, False, True]),
        "X_JE": end,
        "lower": np.array([-1.0, -1, 0]),
        "upper": np.array([1.0, 1, 0.3]),
    }
    return SerialChain(**(values | changes))


def test_planar_arm_is_trigonometry():
    q = np.random.default_rng(3).uniform(-1, 1, (20, 3))
    X = planar_arm().forward_kinematics(q)
    angle = q[:, 0] + q[:, 1]
    reach = q[:, 2] + 0.1
    expected = np.stack(
        [
            0.4 * np.cos(q[:, 0]) + reach * np.cos(angle),
            0.4 * np.sin(q[:, 0]) + reach * np.sin(angle),
        ],
        axis=1,
    )
    np.testing.assert_allclose(X[:, :2, 3], expected, atol=1e-14)
    np.testing.assert_allclose(X[:, 0, 0], np.cos(angle), atol=1e-14)
    np.testing.assert_allclose(X[:, 2, 3], 0.0, atol=1e-14)


def test_jacobian_against_finite_differences():
    arm, h = planar_arm(), 1e-6
    q = np.array([0.3, -0.8, 0.2])
    X, J = arm.pose_and_jacobian(q)
    for i in range(3):
        step = h * np.eye(3)[i]
        change = arm.forward_kinematics(q + step) @ se3.inverse(arm.forward_kinematics(q - step))
        twist = se3.log(change) / (2 * h)
        np.testing.assert_allclose(J[:3, i], twist[:3], atol=1e-8)
        moved = arm.forward_kinematics(q + step)[:3, 3] - arm.forward_kinematics(q - step)[:3, 3]
        np.testing.assert_allclose(J[3:, i], moved / (2 * h), atol=1e-8)
    assert X.shape == (4, 4)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"upper": np.array([1.0, np.inf, 1])}, "joint 1 has limits"),
        ({"lower": np.array([2.0, -1, 0])}, "joint 0 has limits"),
    ],
)
def test_bad_chains_are_named(changes, message):
    with pytest.raises(ReachabilityError, match=message):
        planar_arm(**changes)
