"""Damped least squares against forward kinematics, finite differences and a dense solver."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import (
    forward_kinematics,
    manipulability,
    pose_and_jacobian,
)
from feasigrasp_lab.arm import (
    damped_least_squares_kernel,
    damped_velocity_kernel,
    refine,
)


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


def pose_error(q, X_WF):
    return np.abs(forward_kinematics(q) - X_WF).max()


def test_damped_least_squares_converges():
    rng = np.random.default_rng(6)
    Q = random_configurations(300, seed=6)
    Q = Q[manipulability(Q) > 0.03]
    assert len(Q) > 100
    for q, X in zip(Q, forward_kinematics(Q), strict=True):
        start = q + rng.uniform(-0.15, 0.15, 7)
        position, angle = damped_least_squares_kernel(X, start, 100, 0.02)
        assert position < 1e-6 and angle < 1e-6
        assert pose_error(start, X) < 1e-5


def test_damped_least_squares_reports_the_error_that_is_left():
    Q = random_configurations(50, seed=7)
    for q, X in zip(Q[::2], forward_kinematics(Q[1::2]), strict=True):
        position, angle = damped_least_squares_kernel(X, q, 1, 0.5)
        left = forward_kinematics(q)
        assert position == pytest.approx(np.linalg.norm(left[:3, 3] - X[:3, 3]), abs=1e-12)
        expected = se3.rotation_angle(X[:3, :3] @ left[:3, :3].T)
        assert angle == pytest.approx(float(expected), abs=1e-9)


def test_damped_least_squares_with_no_step_stays():
    q = np.full(7, 0.5)
    damped_least_squares_kernel(np.eye(4), q, 0, 0.02)
    np.testing.assert_array_equal(q, 0.5)


def test_damped_least_squares_stays_finite_at_singular_and_unreachable_poses():
    far = np.eye(4)
    far[:3, 3] = [3.0, 0.0, 0.0]
    for X in (forward_kinematics(np.zeros(7)), far):
        q = np.zeros(7)
        position, _ = damped_least_squares_kernel(X, q, 50, 0.02)
        assert np.isfinite(q).all() and np.isfinite(position)
    assert position > 3.0 - (0.8 + 0.126 + 0.34)


@pytest.mark.parametrize("damping", [0.001, 0.05, 1.0])
def test_damped_velocity_is_the_regularised_solution(damping):
    """min |J qd - V|^2 + damping^2 |qd|^2, as a plain least-squares problem."""
    rng = np.random.default_rng(8)
    for J in pose_and_jacobian(random_configurations(50, seed=8))[1]:
        V, qd = rng.normal(size=6), np.empty(7)
        damped_velocity_kernel(J, V, damping, np.empty((6, 6)), np.empty(6), qd)
        A = np.vstack([J, damping * np.eye(7)])
        expected = np.linalg.lstsq(A, np.append(V, np.zeros(7)), rcond=None)[0]
        np.testing.assert_allclose(qd, expected, rtol=1e-6, atol=1e-8)


def test_one_step_moves_the_flange_by_the_error():
    """To first order, without damping: the Jacobian is that of Drake, tested elsewhere."""
    Q = random_configurations(100, seed=9)
    Q = Q[manipulability(Q) > 0.03]
    twist = np.array([2e-4, -1e-4, 1e-4, 1e-4, 2e-4, -1e-4])
    X = forward_kinematics(Q)
    targets = X.copy()
    targets[:, :3, :3] = se3.so3_exp(twist[:3]) @ X[:, :3, :3]
    targets[:, :3, 3] += twist[3:]
    q, position, angle = refine(targets, Q, 1, 1e-6)
    assert position.max() < 1e-5 and angle.max() < 1e-5
    assert (np.abs(q - Q).max(axis=1) > 1e-5).all()


def test_a_batch_is_one_by_one():
    rng = np.random.default_rng(10)
    Q = random_configurations(40, seed=10)
    X = forward_kinematics(Q)
    starts = Q + rng.uniform(-0.1, 0.1, Q.shape)
    given = starts.copy()
    q, position, angle = refine(X, starts, 3, 0.02)
    np.testing.assert_array_equal(starts, given)
    for k in range(len(Q)):
        one = starts[k].copy()
        assert damped_least_squares_kernel(X[k], one, 3, 0.02) == (position[k], angle[k])
        np.testing.assert_array_equal(one, q[k])


def test_joints_are_kept_inside_their_limits():
    rng = np.random.default_rng(11)
    Q = np.sign(random_configurations(40, seed=11)) * IIWA_7.upper
    X = forward_kinematics(Q * rng.uniform(0.95, 1.1, Q.shape))
    free = 0.9 * Q
    for k in range(len(X)):
        damped_least_squares_kernel(X[k], free[k], 5, 0.02)
    assert (np.abs(free) > IIWA_7.upper).any()
    q, position, _ = refine(X, 0.9 * Q, 5)
    assert (np.abs(q) <= IIWA_7.upper).all()
    left = np.linalg.norm(forward_kinematics(q)[:, :3, 3] - X[:, :3, 3], axis=1)
    np.testing.assert_allclose(position, left, atol=1e-12)


def test_what_is_not_finite_stays_so_and_disturbs_nothing_else():
    Q = random_configurations(3, seed=12)
    X, starts = forward_kinematics(Q).copy(), Q + 0.05
    X[0, 1, 1] = np.nan
    starts[1, 2] = np.nan
    q, position, angle = refine(X, starts, 3)
    assert not np.isfinite(position[:2] + angle[:2]).any()
    expected = refine(X[2:], starts[2:], 3)
    np.testing.assert_array_equal(q[2], expected[0][0])
    assert position[2] < 0.01


def test_shapes():
    for got in refine(np.zeros((0, 4, 4)), np.zeros((0, 7)), 3):
        assert len(got) == 0
    with pytest.raises(ValueError, match=r"give \(n, 4, 4\) and \(n, 7\)"):
        refine(np.zeros((2, 4, 4)), np.zeros((3, 7)), 3)
