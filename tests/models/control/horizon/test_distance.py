"""The distance field's quadratic form at a knot against closed form and the field's own step."""

import numpy as np
import pytest

from feasigrasp.models.control.horizon.distance import (
    NOISE_VARIANCE,
    distance_kernel,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
    length_scale_kernel,
)
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from tests.plan_knots import empty_form, knots_at, neighbours

X_FG = se3.make_pose(se3.so3_exp([0.0, 0.0, 0.4]), [0.0, 0.0, 0.15])
X_WO = se3.make_pose(se3.so3_exp([0.3, -0.2, 0.5]), [0.5, 0.1, 0.4])
DIRECT, CORRIDOR = ApproachCorridor(max_standoff=0.0), ApproachCorridor()
Q = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1])
OPTIONS = ProgramOptions(distance=100.0)
WEIGHT = OPTIONS.distance


def held(solutions):
    """Grasps that configurations (n, 7) hold, with branches and arm angles."""
    X_OG = se3.inverse(X_WO) @ forward_kinematics(solutions, X_FG)
    branch = np.array([branch_kernel(IIWA_7.chain, q) for q in solutions])
    return X_OG, branch, np.array([arm_angle_kernel(IIWA_7.chain, q) for q in solutions])


def quadratic_form(q, grasps, penalty, *, share=1.0, corridor=DIRECT, X_WO=X_WO):
    """Hessian (7, 7) and gradient (7,) at one knot."""
    X_OG, branch, psi = grasps
    knots, form = knots_at(q[None], X_FG, X_WO[None], share=share), empty_form()
    found = neighbours(X_OG, np.array(penalty) / OPTIONS.speed, branch, psi)
    distance_kernel(knots, found, corridor.parameters, se3.inverse(X_FG), OPTIONS.record, form)
    return form.H[0], form.g[0]


def test_one_solution_is_a_spring_to_it():
    rng = np.random.default_rng(0)
    for _ in range(10):
        solution = Q + rng.uniform(-0.2, 0.2, 7)
        H, g = quadratic_form(Q, held(solution[None]), [0.3])
        np.testing.assert_allclose(H, WEIGHT * np.eye(7))
        np.testing.assert_allclose(g, WEIGHT * (Q - solution), atol=1e-4 * WEIGHT)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_the_solution_is_that_of_the_grasp_pulled_back(share):
    X_OG, branch, psi = held((Q + 0.05)[None])
    X_OH = se3.inverse(X_WO) @ forward_kinematics(Q, X_FG)
    back = share * standoff_kernel(X_OG[0], X_OH, CORRIDOR.parameters)
    assert (back > 0.02) == (share > 0.0)
    _, g = quadratic_form(Q, (X_OG, branch, psi), [0.0], share=share, corridor=CORRIDOR)
    target = Q - g / WEIGHT
    X_WT = forward_kinematics(target, X_FG)
    expected = X_WO @ X_OG[0]
    expected[:3, 3] -= back * expected[:3, 2]
    np.testing.assert_allclose(X_WT, expected, atol=1e-5)
    assert branch_kernel(IIWA_7.chain, target) == branch[0]
    assert arm_angle_kernel(IIWA_7.chain, target) == pytest.approx(psi[0], abs=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_with_several_the_target_is_a_step_down_the_field(seed):
    rng = np.random.default_rng(seed)
    solutions, penalty = Q + rng.uniform(-0.3, 0.3, (6, 7)), rng.uniform(0.0, 0.3, 6)
    r, lowest, beta, gradient = np.empty((6, 6)), np.empty(6), np.empty(6), np.empty(7)
    distances_kernel(solutions, r)
    scale = length_scale_kernel(r)
    fit_kernel(r, penalty, scale, NOISE_VARIANCE, lowest, beta)
    _, left = evaluate_kernel(Q, solutions, lowest, beta, scale, gradient, np.empty(6))
    H, g = quadratic_form(Q, held(solutions), penalty)
    np.testing.assert_allclose(H, WEIGHT * np.eye(7))
    np.testing.assert_allclose(Q - g / WEIGHT, Q - left * gradient, atol=1e-5)
    assert np.linalg.norm(left * gradient) > 0.05


def test_one_that_costs_much_more_does_not_draw():
    solutions = Q + np.array([0.3, -0.2])[:, None] * np.ones(7)
    for penalty, k in (([0.0, 5.0], 0), ([5.0, 0.0], 1)):
        _, g = quadratic_form(Q, held(solutions), penalty)
        np.testing.assert_allclose(Q - g / WEIGHT, solutions[k], atol=0.02)


def test_without_a_solution_nothing_is_added():
    """Out of reach, and beyond a joint limit."""
    grasps = held((Q + 0.1)[None])
    far = X_WO + 3.0 * np.eye(4)[0][:, None] * np.eye(4)[3]
    beyond = held(np.array([[0.1, 2.09, 0.1, 1.4, 0.1, -0.8, 0.1]]))
    for each, where in ((grasps, far), (beyond, X_WO)):
        H, g = quadratic_form(Q, each, [0.0], X_WO=where)
        assert not H.any() and not g.any()


def test_solutions_that_there_are_count_without_those_that_there_are_not():
    grasps = held(np.array([Q + 0.1, [0.1, 2.09, 0.1, 1.4, 0.1, -0.8, 0.1]]))
    alone = quadratic_form(Q, held((Q + 0.1)[None]), [0.0])
    for order in ([0, 1], [1, 0]):
        both = quadratic_form(Q, tuple(each[order] for each in grasps), [0.0, 0.0])
        for one, other in zip(alone, both, strict=True):
            np.testing.assert_allclose(one, other, atol=1e-9)
