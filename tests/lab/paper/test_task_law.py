"""The paper's task-space law, which enforces nothing, and the twist that it asks of the hand."""

import dataclasses

import numpy as np
import pytest

from feasigrasp.errors import ScenarioError
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp_lab.baselines.nearest_grasp_controller import MAX_LINEAR
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.grasp_mixture import GraspMixture, fit_grasp_mixture
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.paper.predicted_reachability import judge_grasps
from feasigrasp_lab.paper.task_law import (
    GAINS,
    hand_twist_kernel,
    least_norm_kernel,
    paper_task_space_velocity,
)
from tests.lab.paper.ascents import ascent_direction

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
X_FG = Reachability().gripper.X_FG
OPTIONS = PaperOptions()
STILL = np.zeros(6)


def components_at(X_OG):
    """A mixture with one component, and one member, per pose."""
    n = len(X_OG)
    covariance = np.tile(np.diag([0.01] * 3 + [1e-4] * 3), (n, 1, 1))
    mixture = RiemannianMixture(np.full(n, 1 / n), X_OG, covariance)
    return GraspMixture(mixture, X_OG, np.arange(n), np.arange(n), np.arange(n))


def test_the_papers_law_follows_the_mixture(ring_of_grasps):
    """J qd is the object's twist plus the preconditioned direction, and converges to a grasp."""
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    grasps = judge_grasps(ring_of_grasps, X_WO, STILL, Reachability()).grasps
    mixture = fit_grasp_mixture(grasps, 10, np.random.default_rng(0))
    X_WH, J = pose_and_jacobian(HOME, X_FG)
    undamped = dataclasses.replace(OPTIONS, damping=0.0)
    qd = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, undamped)
    carried = V_WO[3:] + np.cross(V_WO[:3], X_WH[:3, 3] - X_WO[:3, 3])
    relative = J @ qd - np.concatenate([V_WO[:3], carried])
    body = np.concatenate([X_WH[:3, :3].T @ relative[:3], X_WH[:3, :3].T @ relative[3:]])
    direction = ascent_direction(mixture.targets, se3.inverse(X_WO) @ X_WH)
    # Nothing is cut: with this gain it is faster than a baseline would let it be.
    np.testing.assert_allclose(body, GAINS[0] * direction, atol=1e-9)
    assert np.linalg.norm(body[3:]) > MAX_LINEAR

    q = HOME
    for _ in range(800):
        q = q + 0.01 * paper_task_space_velocity(q, mixture, X_WO, STILL, X_FG, OPTIONS)
    tangents = se3.log(se3.inverse(grasps.X_OG) @ se3.inverse(X_WO) @ forward_kinematics(q, X_FG))
    assert np.linalg.norm(tangents, axis=1).min() < 1e-3


def test_the_printed_law_is_the_gradient_through_the_pseudo_inverse(ring_of_grasps):
    """Finite differences of the log density along the body axes, about means, without the twist."""
    X_WO, V_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5]), np.full(6, 0.2)
    mixture = fit_grasp_mixture(ring_of_grasps, 10, np.random.default_rng(0))
    printed = PaperOptions(
        law="gradient", gain=0.01, damping=0.0, feed_forward=False, targets="means"
    )
    X_WH, J = pose_and_jacobian(HOME, X_FG)
    X_OH, h = se3.inverse(X_WO) @ X_WH, 1e-6
    ahead, behind = (
        mixture.mixture.log_density(X_OH @ se3.exp(sign * h * np.eye(6))) for sign in (1.0, -1.0)
    )
    gradient = (ahead - behind) / (2.0 * h)
    twist = np.concatenate([X_WH[:3, :3] @ gradient[:3], X_WH[:3, :3] @ gradient[3:]])
    qd = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, printed)
    expected = np.linalg.pinv(J) @ (0.01 * twist)
    np.testing.assert_allclose(qd, expected, atol=1e-5 * np.abs(expected).max())
    # Every difference to the corrected law shows.
    for change in (
        {"law": "preconditioned"},
        {"damping": 0.1},
        {"feed_forward": True},
        {"targets": "medoids"},
    ):
        other = dataclasses.replace(printed, **change)
        apart = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, other) - qd
        assert np.abs(apart).max() > 1e-3 * np.abs(qd).max(), change


@pytest.mark.parametrize("word", [{"law": "newton"}, {"targets": "modes"}])
def test_other_words_are_refused(word):
    with pytest.raises(ScenarioError, match="choose one of"):
        PaperOptions(**word)


def test_the_papers_law_leaves_the_middle_between_a_grasp_and_its_twin():
    """Both pull as strongly, in opposite directions."""
    X_WH = forward_kinematics(HOME, X_FG)
    turns = [se3.exp([0, 0, angle, 0, 0, 0]) for angle in (np.pi / 2, -np.pi / 2)]
    mixture = components_at(X_WH @ np.array(turns))
    q = HOME
    for _ in range(800):
        q = q + 0.01 * paper_task_space_velocity(q, mixture, np.eye(4), STILL, X_FG, OPTIONS)
    reached = se3.log(se3.inverse(mixture.X_OG) @ forward_kinematics(q, X_FG))
    assert np.linalg.norm(reached, axis=1).min() < 1e-3


def test_the_relative_twist_is_shortened_in_proportion():
    def shortened(u, max_angular, max_linear):
        return hand_twist_kernel(u, np.eye(4), np.eye(4), STILL, max_angular, max_linear)

    u = np.array([3.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(shortened(u, 1.5, 0.4), u / 2)
    np.testing.assert_allclose(shortened(u, 1.5, 0.04), u / 2.5)
    np.testing.assert_array_equal(shortened(u, 4.0, 0.2), u)
    np.testing.assert_array_equal(shortened(STILL, 1.5, 0.4), STILL)


@pytest.mark.parametrize("relative", [False, True])
def test_the_hands_twist_by_finite_differences(relative):
    """Of a hand that moves in the body frame while the object carries it along."""
    rng = np.random.default_rng(3)
    X_WO, X_OH = se3.random_pose(rng, 2)
    V_WO, u_H, h = rng.normal(size=6), relative * rng.normal(size=6), 1e-6
    ahead, behind = (se3.extrapolate(X_WO, V_WO, dt) @ X_OH @ se3.exp(dt * u_H) for dt in (h, -h))
    V = hand_twist_kernel(u_H, X_WO @ X_OH, X_WO, V_WO, np.inf, np.inf)
    np.testing.assert_allclose(V[3:], (ahead - behind)[:3, 3] / (2 * h), atol=1e-8)
    angular = se3.so3_log(ahead[:3, :3] @ behind[:3, :3].T) / (2 * h)
    np.testing.assert_allclose(V[:3], angular, atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_pseudo_inverse(seed):
    rng = np.random.default_rng(seed)
    J = pose_and_jacobian(rng.uniform(-2, 2, 7))[1]
    V = rng.normal(size=6)
    expected = np.linalg.pinv(J) @ V
    # The error grows with the square of the condition number, as in any Cholesky solution.
    assert np.linalg.norm(least_norm_kernel(J, V, 0.0) - expected) < 1e-12 * (
        np.linalg.cond(J) ** 2
    ) * np.linalg.norm(expected)


def test_the_hand_moves_as_asked_and_the_null_space_is_left_alone():
    q = np.deg2rad([10, 40, -20, -70, 30, 60, 5])
    J = pose_and_jacobian(q)[1]
    V = np.array([0.1, -0.2, 0.3, 0.05, 0.0, -0.1])
    qd = least_norm_kernel(J, V, 0.0)
    np.testing.assert_allclose(J @ qd, V, atol=1e-9)
    null = np.linalg.svd(J)[2][6]
    assert abs(null @ qd) < 1e-9


@pytest.mark.parametrize(
    "q",
    [np.zeros(7), np.deg2rad([0, 30, 0, 0, 0, 60, 0])],
    ids=["upright", "elbow stretched"],
)
def test_where_the_jacobian_loses_rank_the_answer_is_finite(q):
    J = pose_and_jacobian(q)[1]
    assert np.linalg.svd(J)[1][-1] < 1e-9
    for V in np.eye(6):
        assert np.isfinite(least_norm_kernel(J, V, 0.0)).all()


@pytest.mark.parametrize("damping", [0.01, 0.05, 0.3])
def test_damping_trades_the_twist_for_speed(damping):
    """The damped solution is the least-squares one of ``[J; damping I] qd = [V; 0]``."""
    rng = np.random.default_rng(0)
    for q in (np.zeros(7), *rng.uniform(-2, 2, (20, 7))):
        J, V = pose_and_jacobian(q)[1], rng.normal(size=6)
        rows = np.vstack([J, damping * np.eye(7)])
        expected = np.linalg.lstsq(rows, np.r_[V, np.zeros(7)], rcond=None)[0]
        qd = least_norm_kernel(J, V, damping)
        np.testing.assert_allclose(qd, expected, atol=1e-9)
        assert np.linalg.norm(qd) <= np.linalg.norm(V) / (2.0 * damping)


def test_numbers_that_are_none_stay_so():
    J = pose_and_jacobian(np.full(7, 0.3))[1]
    assert np.isnan(least_norm_kernel(J, np.full(6, np.nan), 0.0)).any()
