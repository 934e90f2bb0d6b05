"""Solutions as functions of the object's pose and of time, against forward kinematics."""

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp_lab.paper.joint_law import candidate_velocity_kernel, feed_forward_kernel
from feasigrasp_lab.paper.solutions import Solutions, place_kernel

X_FG = ParallelGripper().X_FG
X_GF = se3.inverse(X_FG)


def branches_of(q):
    return np.array([branch_kernel(IIWA_7.chain, one) for one in q])


def solutions_at(q, X_WO):
    """Solutions whose configurations are ``q`` (n, 7) while the object is at ``X_WO``."""
    n = len(q)
    X_OG = se3.inverse(X_WO) @ forward_kinematics(q, X_FG)
    arm_angle = np.array([arm_angle_kernel(IIWA_7.chain, one) for one in q])
    return Solutions(X_OG, branches_of(q), arm_angle, np.zeros((n, 2)), np.array([0.1, 0.0]))


def placed(solutions, X_WO):
    n = len(solutions)
    X_WF, q, index = np.empty((n, 4, 4)), np.empty((n, 7)), np.empty(n, dtype=np.int64)
    count = place_kernel(
        X_WO, solutions.X_OG, solutions.branch, solutions.arm_angle, X_GF, X_WF, q, index
    )
    return X_WF[:count], q[:count], index[:count]


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_where_the_object_is_still_the_configurations_are_what_they_were(seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, (5, 7)) * (IIWA_7.upper - IIWA_7.position_margin)
    X_WO = se3.random_pose(rng, 1)[0]
    _, found, index = placed(solutions_at(q, X_WO), X_WO)
    np.testing.assert_array_equal(index, np.arange(5))
    np.testing.assert_allclose(found, q, atol=1e-6)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50)
def test_they_reach_their_grasps_wherever_the_object_goes(seed):
    rng = np.random.default_rng(seed)
    q, X_WO = rng.uniform(-1, 1, (8, 7)) * IIWA_7.upper, se3.random_pose(rng, 1)[0]
    solutions = solutions_at(q, X_WO)
    X_WO = se3.extrapolate(X_WO, rng.normal(scale=0.2, size=6), 1.0)
    X_WF, found, index = placed(solutions, X_WO)
    # Where the arm may not go there is no solution, or it would be stopped on its way and stay.
    assert (np.abs(found) <= IIWA_7.upper - IIWA_7.position_margin).all()
    np.testing.assert_array_equal(branches_of(found), solutions.branch[index])
    targets = X_WO @ solutions.X_OG[index]
    np.testing.assert_allclose(X_WF @ X_FG, targets, atol=1e-9)
    np.testing.assert_allclose(forward_kinematics(found, X_FG), targets, atol=1e-9)


def test_what_is_out_of_reach_or_no_pose_is_left_out():
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (4, 7)) * IIWA_7.upper
    solutions = solutions_at(q, np.eye(4))
    for X_WO in (se3.make_pose(np.eye(3), [3.0, 0.0, 0.0]), np.full((4, 4), np.nan)):
        assert len(placed(solutions, X_WO)[2]) == 0


@pytest.mark.parametrize("seed", range(5))
def test_their_velocity_is_that_of_the_jacobian_at_a_fixed_arm_angle(seed):
    """``J qd`` is the twist of the flange, and the arm angle stays."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.7, 0.7, 7) * IIWA_7.upper
    q[[1, 3, 5]] = rng.choice([-1.0, 1.0], 3) * rng.uniform(0.4, 1.6, 3)  # not singular
    X_WF, J = pose_and_jacobian(q)
    V_WO, p_WO = rng.normal(size=6), rng.normal(size=3)
    V_WF = V_WO.copy()
    V_WF[3:] += np.cross(V_WO[:3], X_WF[:3, 3] - p_WO)
    qd, moved = np.empty(7), np.eye(4)
    branch, psi = branch_kernel(IIWA_7.chain, q), arm_angle_kernel(IIWA_7.chain, q)
    assert candidate_velocity_kernel(X_WF, V_WO, p_WO, branch, psi, q, moved, qd)
    np.testing.assert_allclose(J @ qd, V_WF, atol=1e-3)
    ahead, behind = (arm_angle_kernel(IIWA_7.chain, q + sign * 1e-6 * qd) for sign in (1, -1))
    assert (ahead - behind) / 2e-6 == pytest.approx(0.0, abs=1e-3)


def test_what_is_fed_forward_is_the_mean():
    rng = np.random.default_rng(1)
    q = rng.uniform(-0.6, 0.6, (3, 7)) * IIWA_7.upper
    solutions, X_WO = solutions_at(q, np.eye(4)), np.eye(4)
    X_WF, found, index = placed(solutions, X_WO)

    def forward(V_WO, weights):
        qd, of = np.empty(7), (solutions.branch, solutions.arm_angle, index)
        feed_forward_kernel(X_WF, V_WO, np.zeros(3), *of, weights, found, qd)
        return qd

    V_WO = 0.02 * rng.normal(size=6)
    each = [forward(V_WO, weights) for weights in np.eye(3)]
    weights = np.array([0.5, 0.3, 0.2])
    np.testing.assert_allclose(forward(V_WO, weights), weights @ each, atol=1e-7)
    # However fast that is: nothing is cut.
    fast = forward(100.0 * V_WO, weights)
    assert np.max(np.abs(fast) / IIWA_7.velocity_limits) > 2.0
    np.testing.assert_allclose(
        fast / np.linalg.norm(fast), weights @ each / np.linalg.norm(weights @ each), atol=1e-3
    )


def test_between_updates_costs_and_length_scale_are_linear_in_time():
    solutions = Solutions(
        np.eye(4)[None], np.zeros(1), np.array([0.5]), np.array([[2.0, -3.0]]), np.array([0.1, 0.2])
    )
    cost, scale = solutions.at(0.05)
    np.testing.assert_allclose(cost, [1.85])
    assert scale == pytest.approx(0.11)


def test_a_copy_is_the_same():
    empty = Solutions.empty()
    assert copy.deepcopy(empty) is empty and len(empty) == 0
