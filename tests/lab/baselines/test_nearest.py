"""The baseline that follows the nearest reachable grasp, against forward kinematics."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.baselines.nearest_grasp_controller import (
    NearestGrasp,
    nearest_grasp,
    nearest_grasp_velocity,
)
from feasigrasp_lab.paper.options import PaperOptions

REACH = Reachability()
HOME = np.deg2rad([10.0, -40.0, 5.0, -95.0, 5.0, 75.0, 10.0])
X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, -0.3]), [0.5, 0.1, 0.5])
STILL = np.zeros(6)


def grasp_at(q):
    """A grasp that the arm holds in configuration q."""
    return se3.inverse(X_WO) @ forward_kinematics(q, REACH.gripper.X_FG)


def travel_time(q):
    return np.max(np.abs(q - HOME) / IIWA_7.velocity_limits)


def test_the_grasp_that_is_reached_first_is_chosen():
    near, far = HOME + 0.05, HOME + [1.5, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0]
    X_OG = np.stack([grasp_at(far), grasp_at(near)])
    chosen = nearest_grasp(NearestGrasp(), HOME, X_OG, X_WO, REACH)
    np.testing.assert_allclose(chosen.X_OG, X_OG[1])
    held = forward_kinematics(chosen.q, REACH.gripper.X_FG)
    np.testing.assert_allclose(held, X_WO @ X_OG[1], atol=1e-9)
    assert travel_time(chosen.q) < travel_time(far) / 5.0


def test_what_is_followed_is_left_only_for_one_that_is_much_nearer():
    step = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    followed = NearestGrasp(grasp_at(HOME + 0.3 * step))
    nearer = grasp_at(HOME + 0.2 * step)
    both = np.stack([followed.X_OG, nearer])
    kept = nearest_grasp(followed, HOME, both, X_WO, REACH)
    np.testing.assert_array_equal(kept.X_OG, followed.X_OG)
    turned = HOME + 2.0 * step  # one is here now, and the other one far
    both = np.stack([followed.X_OG, grasp_at(turned)])
    np.testing.assert_allclose(nearest_grasp(followed, turned, both, X_WO, REACH).X_OG, both[1])
    gone = nearest_grasp(followed, HOME, nearer[None], X_WO, REACH)
    np.testing.assert_allclose(gone.X_OG, nearer)


@pytest.mark.parametrize("X_OG", [np.zeros((0, 4, 4)), se3.make_pose(np.eye(3), [3.0, 0, 0])[None]])
def test_nothing_in_reach_is_nothing_to_follow(X_OG):
    chosen = nearest_grasp(NearestGrasp(), HOME, X_OG, X_WO, REACH)
    assert not chosen
    qd = nearest_grasp_velocity(HOME, chosen, X_WO, STILL, REACH, PaperOptions())
    np.testing.assert_array_equal(qd, np.zeros(7))


@pytest.mark.parametrize("feed_forward", [True, False])
def test_the_hand_arrives_and_lags_behind_by_speed_over_gain_without_feed_forward(feed_forward):
    """Along the approach direction, on an object that moves: 4 cm/s over 5/s is 8 mm."""
    options = PaperOptions(feed_forward=feed_forward)
    grasp = NearestGrasp(grasp_at(HOME + 0.1), HOME + 0.1)
    V_WO, dt, q, X = np.array([0.0, 0.0, 0.0, 0.0, -0.04, 0.0]), 0.005, HOME.copy(), X_WO.copy()
    for _ in range(600):
        q = q + dt * nearest_grasp_velocity(q, grasp, X, V_WO, REACH, options)
        X[:3, 3] += dt * V_WO[3:]
    error = np.linalg.norm(
        forward_kinematics(q, REACH.gripper.X_FG)[:3, 3] - (X @ grasp.X_OG)[:3, 3]
    )
    assert error == pytest.approx(0.0 if feed_forward else 0.008, abs=1e-3)
