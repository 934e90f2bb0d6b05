"""The pseudo-inverse solution against NumPy's."""

import numpy as np
import pytest

from feasigrasp.models.iiwa_kinematics import pose_and_jacobian
from feasigrasp.models.least_norm import least_norm_velocity


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


def test_numbers_that_are_none_stay_so():
    J = pose_and_jacobian(np.full(7, 0.3))[1]
    assert np.isnan(least_norm_velocity(J, np.full(6, np.nan))).any()
