"""The pseudo-inverse solutions, plain and damped, against NumPy's."""

import numpy as np
import pytest

from feasigrasp.models.control.task.least_norm import least_norm_velocity
from feasigrasp.models.robot.kinematics import pose_and_jacobian


@pytest.mark.parametrize("seed", range(20))
def test_it_is_the_pseudo_inverse(seed):
    rng = np.random.default_rng(seed)
    J = pose_and_jacobian(rng.uniform(-2, 2, 7))[1]
    V = rng.normal(size=6)
    expected = np.linalg.pinv(J) @ V
    # The error grows with the square of the condition number, as in any Cholesky solution.
    assert np.linalg.norm(least_norm_velocity(J, V) - expected) < 1e-12 * (
        np.linalg.cond(J) ** 2
    ) * np.linalg.norm(expected)


def test_the_hand_moves_as_asked_and_the_null_space_is_left_alone():
    q = np.deg2rad([10, 40, -20, -70, 30, 60, 5])
    J = pose_and_jacobian(q)[1]
    V = np.array([0.1, -0.2, 0.3, 0.05, 0.0, -0.1])
    qd = least_norm_velocity(J, V)
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
        assert np.isfinite(least_norm_velocity(J, V)).all()


@pytest.mark.parametrize("damping", [0.01, 0.05, 0.3])
def test_damping_trades_the_twist_for_speed(damping):
    """The damped solution is the least-squares one of ``[J; damping I] qd = [V; 0]``."""
    rng = np.random.default_rng(0)
    for q in (np.zeros(7), *rng.uniform(-2, 2, (20, 7))):
        J, V = pose_and_jacobian(q)[1], rng.normal(size=6)
        rows = np.vstack([J, damping * np.eye(7)])
        expected = np.linalg.lstsq(rows, np.r_[V, np.zeros(7)], rcond=None)[0]
        qd = least_norm_velocity(J, V, damping)
        np.testing.assert_allclose(qd, expected, atol=1e-9)
        assert np.linalg.norm(qd) <= np.linalg.norm(V) / (2.0 * damping)


def test_numbers_that_are_none_stay_so():
    J = pose_and_jacobian(np.full(7, 0.3))[1]
    assert np.isnan(least_norm_velocity(J, np.full(6, np.nan))).any()
