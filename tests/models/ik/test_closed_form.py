"""Closed-form inverse kinematics against forward kinematics and plain search."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.redundancy import redundancy_samples_kernel, travel_times_kernel
from feasigrasp.models.ik.self_motion import (
    arm_angle,
    closed_form,
    inside_limits_kernel,
    next_nearest_kernel,
    self_motion_kernel,
    travel_time_kernel,
)
from feasigrasp.models.numerics.fast_math import fast_atan2
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics


def random_configurations(n, seed=0):
    return IIWA_7.random_positions(np.random.default_rng(seed), n)


def nearest_inside_limits(poses, near, psis, margin=0.0):
    """Of each pose (n, 4, 4) the configuration of `psis` that is soonest reached, and its time."""
    found, times = np.full((len(poses), 7), np.nan), np.full(len(poses), np.inf)
    samples, candidate = (
        redundancy_samples_kernel(np.asarray(psis, dtype=float), np.nan),
        np.empty(7),
    )
    for n, circle in enumerate(self_motion_kernel(IIWA_7.chain, X) for X in poses):
        if not circle.reached:
            continue
        travel_times_kernel(IIWA_7.chain, circle, near, margin, samples)
        while next_nearest_kernel(circle, samples, candidate) < np.inf:
            # Angles next to a singularity are rough until the configuration is written.
            if inside_limits_kernel(IIWA_7.chain, candidate, margin):
                found[n], times[n] = candidate, travel_time_kernel(IIWA_7.chain, candidate, near)
                break
    return found, times


def pose_error(q, X_WF):
    return np.abs(forward_kinematics(q) - X_WF).max()


def test_every_solution_reaches_the_pose():
    rng = np.random.default_rng(1)
    poses = forward_kinematics(random_configurations(10_000))
    found = closed_form(poses, rng.uniform(-np.pi, np.pi, len(poses)))
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
    assert np.isnan(closed_form(X, 0.3)).all()


def test_a_pose_that_is_not_finite_gives_no_solution():
    X = np.eye(4)
    X[0, 3] = np.nan
    assert np.isnan(closed_form(X, 0.0)).all()
    for i in range(3):
        for j in range(4):
            X = forward_kinematics(np.full(7, 0.3)).copy()
            X[i, j] = [np.nan, np.inf, -np.inf][(i + j) % 3]
            assert np.isnan(closed_form(X, 0.0)).all()
    assert np.isnan(closed_form(forward_kinematics(np.full(7, 0.3)), np.nan)).all()


def test_one_pose_and_many():
    poses = forward_kinematics(random_configurations(6, seed=6)).reshape(2, 3, 4, 4)
    poses[1, 1] = np.nan
    psi = np.arange(6.0).reshape(2, 3)
    many, one_angle = closed_form(poses, psi), closed_form(poses, 2.0)
    assert many.shape == one_angle.shape == (2, 3, 8, 7)
    for k in np.ndindex(2, 3):
        np.testing.assert_array_equal(many[k], closed_form(poses[k], psi[k]))
        np.testing.assert_array_equal(one_angle[k], closed_form(poses[k], 2.0))
    assert np.isnan(many[1, 1]).all() and np.isfinite(many).sum() == 5 * 8 * 7
    assert closed_form(np.zeros((0, 4, 4)), 0.0).shape == (0, 8, 7)
    with pytest.raises(ValueError, match=r"\(\.\.\., 4, 4\)"):
        closed_form(np.eye(3), 0.0)


def test_what_is_no_rotation_is_refused():
    X = forward_kinematics(np.full(7, 0.3))
    mirrored, scaled, flat = X.copy(), X.copy(), X.copy()
    mirrored[:3, 0] *= -1.0
    scaled[:3, :3] *= 1.001
    flat[:3, :3] = 0.0
    for bad in (mirrored, scaled, flat):
        with pytest.raises(ValueError, match="X_WF .* is no rotation"):
            closed_form(bad, 0.3)
    rounded = X.astype(np.float32)
    assert pose_error(closed_form(rounded, 0.3), rounded) < 1e-6


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
        # A straight elbow is the edge of the workspace: rounding beyond it is forgiven.
        assert len(solutions) == 8
        assert pose_error(solutions, X) < 1e-11


def test_the_whole_arm_upright():
    X = forward_kinematics(np.zeros(7))
    solutions = closed_form(X, arm_angle(np.zeros(7)))
    assert solutions.shape == (8, 7) and np.isfinite(solutions).all()
    assert pose_error(solutions, X) < 1e-11


@pytest.mark.parametrize("joints", [(1,), (5,), (1, 5)])
def test_with_parallel_axes_the_later_joint_is_zero(joints):
    """Of the axes that coincide where joint 2 or 6 is zero, the first one takes all of the turn."""
    Q = random_configurations(50, seed=8)
    Q[:, joints] = 0.0
    for q, X in zip(Q, forward_kinematics(Q), strict=True):
        solutions = closed_form(X, arm_angle(q))
        for joint in joints:
            # The other elbow branch has its singularity elsewhere.
            positive = solutions[[0, 4]][np.abs(solutions[[0, 4], joint]) < 1e-7]
            assert len(positive) == 1 and abs(positive[0, joint + 1]) < 1e-7


def test_a_wrist_above_the_base():
    """S-C is the base axis: the arm angle counts from the x-z plane, and is still found again."""
    q = np.array([0.4, -0.5, 0.0, 1.0, 0.3, 0.6, -0.8])
    q[1] = -np.arctan2(-0.4 * np.sin(q[3]), 0.4 + 0.4 * np.cos(q[3]))
    X = forward_kinematics(q)
    wrist = X[:3, 3] - 0.126 * X[:3, 2]
    if np.hypot(*wrist[:2]) > 1e-9:
        q[1] = -q[1]
        X = forward_kinematics(q)
        wrist = X[:3, 3] - 0.126 * X[:3, 2]
    assert np.hypot(*wrist[:2]) < 1e-9
    solutions = closed_form(X, arm_angle(q))
    assert np.abs(solutions - q).max(axis=1).min() < 1e-9
    assert pose_error(solutions, X) < 1e-12


def test_nearest_inside_limits_is_the_best_of_all_branches():
    rng = np.random.default_rng(9)
    poses = forward_kinematics(random_configurations(60, seed=9))
    psis, margin = np.linspace(-np.pi, np.pi, 16, endpoint=False), 0.2
    for X in poses:
        near = rng.uniform(-IIWA_7.upper, IIWA_7.upper)
        found, times = nearest_inside_limits(X[None], near, psis, margin)
        candidates = np.concatenate([closed_form(X, psi) for psi in psis])
        inside = (np.abs(candidates) <= IIWA_7.upper - margin).all(axis=1)
        if not inside.any():
            assert np.isinf(times[0]) and np.isnan(found).all()
            continue
        travel = np.max(np.abs(candidates[inside] - near) / IIWA_7.velocity_limits, axis=1)
        assert times[0] == pytest.approx(travel.min(), abs=1e-8)
        # Of those that are equally soon, such as both signs of a wrist that is not the slowest, it
        # is the one whose shoulder, or wrist, needs the least.
        ties = candidates[inside][travel < travel.min() + 1e-8]
        assert np.abs(ties - found[0]).max(axis=1).min() < 1e-12
        parts = np.abs(ties - near) / IIWA_7.velocity_limits
        least = np.minimum(parts[:, :4].max(axis=1), parts[:, 4:].max(axis=1)).min()
        mine = np.abs(found[0] - near) / IIWA_7.velocity_limits
        assert min(mine[:4].max(), mine[4:].max()) == pytest.approx(least, abs=1e-6)


def test_nearest_inside_limits_at_singular_poses():
    """What is found is inside the limits and exact there too, and no slower than it says."""
    Q = random_configurations(200, seed=10)
    Q[:100, 5] = 0.0
    Q[100:, 1] = 1e-11
    poses, psis = forward_kinematics(Q), np.linspace(-np.pi, np.pi, 12, endpoint=False)
    found, times = nearest_inside_limits(poses, np.zeros(7), psis)
    finite = np.isfinite(times)
    assert finite.mean() > 0.5
    assert pose_error(found[finite], poses[finite]) < 1e-11
    assert (np.abs(found[finite]) <= IIWA_7.upper).all()
    np.testing.assert_allclose(
        times[finite], np.max(np.abs(found[finite]) / IIWA_7.velocity_limits, axis=1), atol=1e-12
    )


def test_nearest_inside_limits_of_nothing():
    X = np.stack([np.full((4, 4), np.nan), se3.make_pose(np.eye(3), [2.0, 0.0, 0.0])])
    found, times = nearest_inside_limits(X, np.zeros(7), [0.0, 1.0])
    assert np.isinf(times).all() and np.isnan(found).all()


def test_fast_atan2():
    rng = np.random.default_rng(11)
    y, x = rng.normal(size=(2, 20_000)) * 10.0 ** rng.uniform(-8, 8, (2, 20_000))
    angles = np.array([fast_atan2(a, b) for a, b in zip(y, x, strict=True)])
    np.testing.assert_allclose(angles, np.arctan2(y, x), atol=1e-15)
    for a, b in [(0.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.0)]:
        assert fast_atan2(a, b) == pytest.approx(np.arctan2(a, b), abs=1e-15)


def test_inside_limits():
    margin = 0.1
    assert inside_limits_kernel(IIWA_7.chain, IIWA_7.upper - 0.11, margin)
    assert inside_limits_kernel(IIWA_7.chain, -IIWA_7.upper + 0.11, margin)
    for joint in range(7):
        for sign in (-1, 1):
            q = np.zeros(7)
            q[joint] = sign * (IIWA_7.upper[joint] - 0.09)
            assert not inside_limits_kernel(IIWA_7.chain, q, margin)
            assert inside_limits_kernel(IIWA_7.chain, q, 0.0)


def test_travel_time_is_that_of_the_slowest_joint():
    q = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6, 0.7])
    for joint in range(7):
        other = q.copy()
        other[joint] += 0.5 * IIWA_7.velocity_limits[joint]
        other[(joint + 1) % 7] -= 0.1 * IIWA_7.velocity_limits[(joint + 1) % 7]
        assert travel_time_kernel(IIWA_7.chain, q, other) == pytest.approx(0.5)
        assert travel_time_kernel(IIWA_7.chain, other, q) == pytest.approx(0.5)
    assert travel_time_kernel(IIWA_7.chain, q, q) == 0.0
