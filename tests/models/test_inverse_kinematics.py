"""Closed-form and iterative inverse kinematics against forward kinematics."""

import numpy as np
import pytest

from feasigrasp.models import se3
from feasigrasp.models.iiwa import POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.iiwa_kinematics import forward_kinematics, manipulability
from feasigrasp.models.inverse_kinematics import (
    arm_angle,
    closed_form,
    damped_least_squares_kernel,
    inside_limits_kernel,
    travel_time_kernel,
)


def random_configurations(n, seed=0):
    return np.random.default_rng(seed).uniform(-POSITION_LIMITS, POSITION_LIMITS, (n, 7))


def pose_error(q, X_WF):
    return np.abs(forward_kinematics(q) - X_WF).max()


def test_every_solution_reaches_the_pose():
    rng = np.random.default_rng(1)
    poses = forward_kinematics(random_configurations(10_000))
    found = np.array([closed_form(X, rng.uniform(-np.pi, np.pi)) for X in poses])
    assert found.shape == (10_000, 8, 7)
    assert pose_error(found, poses[:, None]) < 1e-9


def test_a_configuration_is_found_from_its_pose_and_arm_angle():
    Q = random_configurations(10_000, seed=2)
    for q, X in zip(Q, forward_kinematics(Q), strict=True):
        assert np.abs(closed_form(X, arm_angle(q)) - q).max(axis=1).min() < 1e-8


def test_the_eight_solutions_differ_in_the_signs_of_joints_2_4_and_6():
    for X in forward_kinematics(random_configurations(50, seed=3)):
        solutions = closed_form(X, 0.4)
        signs = {tuple(row) for row in np.sign(solutions[:, [1, 3, 5]]).astype(int)}
        assert len(signs) == 8


def test_solutions_have_the_arm_angle_that_was_asked_for():
    for X in forward_kinematics(random_configurations(50, seed=4)):
        for psi in (-2.9, -1.0, 0.0, 2.0):
            for q in closed_form(X, psi):
                error = arm_angle(q) - psi
                assert abs((error + np.pi) % (2 * np.pi) - np.pi) < 1e-7


def test_the_arm_angle_turns_the_elbow_about_the_line_from_shoulder_to_wrist():
    q = np.array([0.4, 0.7, -0.3, -1.3, 0.5, 0.8, 0.2])
    X = forward_kinematics(q)
    shoulder, wrist = np.array([0, 0, 0.34]), X[:3, 3] - 0.126 * X[:3, 2]
    axis = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)

    def elbow(q):
        c1, s1, c2, s2 = np.cos(q[0]), np.sin(q[0]), np.cos(q[1]), np.sin(q[1])
        return shoulder + 0.4 * np.array([c1 * s2, s1 * s2, c2])

    psi, turn = arm_angle(q), 0.9
    expected = shoulder + se3.so3_exp(turn * axis) @ (elbow(q) - shoulder)
    same_elbow = [s for s in closed_form(X, psi + turn) if s[3] < 0]
    assert len(same_elbow) == 4
    for solution in same_elbow:
        np.testing.assert_allclose(elbow(solution), expected, atol=1e-9)


@pytest.mark.parametrize("distance", [0.81, 1.0, 5.0, 0.0])
def test_wrist_out_of_reach(distance):
    """The wrist centre can be between 0 (excluded) and 0.8 m from the shoulder."""
    R = se3.so3_exp([0.2, 1.0, -0.4])
    wrist = np.array([0, 0, 0.34]) + distance * np.array([0.6, 0.0, 0.8])
    X = se3.make_pose(R, wrist + 0.126 * R[:, 2])
    assert closed_form(X, 0.3).shape == (0, 7)


def test_nan_pose_gives_no_finite_solution():
    X = np.eye(4)
    X[0, 3] = np.nan
    assert not np.isfinite(closed_form(X, 0.0)).all(axis=1).any()


@pytest.mark.parametrize(
    "joints",
    [(1,), (3,), (5,), (1, 3), (1, 5), (3, 5), (1, 3, 5)],
    ids=lambda joints: "q" + "_q".join(str(j + 1) for j in joints),
)
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-10, 1e-6])
def test_singular_poses_give_right_solutions_or_none(joints, angle):
    Q = random_configurations(100, seed=5)
    Q[:, joints] = angle
    for q, X in zip(Q, forward_kinematics(Q), strict=True):
        psi = arm_angle(q)
        assert np.isfinite(psi)
        solutions = closed_form(X, psi)
        assert np.isfinite(solutions).all()
        # A straight elbow is the edge of the workspace, on either side of which rounding can fall.
        assert len(solutions) == 8 or (3 in joints and len(solutions) == 0)
        assert len(solutions) == 0 or pose_error(solutions, X) < 1e-11


def test_the_whole_arm_upright():
    X = forward_kinematics(np.zeros(7))
    solutions = closed_form(X, arm_angle(np.zeros(7)))
    assert np.isfinite(solutions).all()
    assert len(solutions) == 0 or pose_error(solutions, X) < 1e-11


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


def test_inside_limits():
    margin = 0.1
    assert inside_limits_kernel(POSITION_LIMITS - 0.11, margin)
    assert inside_limits_kernel(-POSITION_LIMITS + 0.11, margin)
    for joint in range(7):
        for sign in (-1, 1):
            q = np.zeros(7)
            q[joint] = sign * (POSITION_LIMITS[joint] - 0.09)
            assert not inside_limits_kernel(q, margin)
            assert inside_limits_kernel(q, 0.0)


def test_travel_time_is_that_of_the_slowest_joint():
    q = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6, 0.7])
    for joint in range(7):
        other = q.copy()
        other[joint] += 0.5 * VELOCITY_LIMITS[joint]
        other[(joint + 1) % 7] -= 0.1 * VELOCITY_LIMITS[(joint + 1) % 7]
        assert travel_time_kernel(q, other) == pytest.approx(0.5)
        assert travel_time_kernel(other, q) == pytest.approx(0.5)
    assert travel_time_kernel(q, q) == 0.0
