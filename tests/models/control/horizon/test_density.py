"""Gradient and bound of the density's quadratic form against the density in NumPy."""

import numpy as np
import pytest
from scipy.special import logsumexp

from feasigrasp.models.control.horizon.density import density_kernel
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from tests.plan_knots import empty_form, knots_at, neighbours

OPTIONS = ProgramOptions()
X_FG = se3.make_pose(np.eye(3), [0.0, 0.0, 0.15])
#: The hand at the grasp itself, whatever its errors, and behind it.
DIRECT, CORRIDOR = ApproachCorridor(max_standoff=0.0), ApproachCorridor()
Q = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1])
X_WO = se3.make_pose(se3.so3_exp([0.3, -0.2, 0.5]), [0.5, 0.1, 0.4])
#: Joints that move the hand along x, y and z.
SLIDES = np.eye(6)[:, [3, 4, 5, 0, 1, 2]] @ np.diag([1.0, 1, 1, 0, 0, 0]) @ np.eye(6, 7)


def quadratic_form(X_WH, J_WH, X_OG, penalty, *, share=1.0, corridor=DIRECT):
    """Hessian (7, 7) and gradient (7,) at one knot."""
    hand, form = ([X_WH], [J_WH]), empty_form()
    knots = knots_at(Q[None], X_FG, X_WO[None], share=share, hand=hand)
    found = neighbours(X_OG, np.array(penalty) / OPTIONS.worth)
    density_kernel(knots, found, corridor.parameters, np.eye(4), OPTIONS.record, form)
    return form.H[0], form.g[0]


def cost(X_WH, X_OT, penalty):
    """``-log sum_m w_m (1 + d_m)^-nu`` of a hand and targets in O, written out."""
    terms = []
    for X, each in zip(X_OT, penalty, strict=True):
        X_WT = X_WO @ X
        turn = se3.so3_log(X_WH[:3, :3] @ X_WT[:3, :3].T) / OPTIONS.tail_angle
        way = (X_WH[:3, 3] - X_WT[:3, 3]) / OPTIONS.tail_position
        terms.append(-each - OPTIONS.tail * np.log(1.0 + turn @ turn + way @ way))
    return -logsumexp(terms)


def scattered(X_OH, n, seed, *, size=(0.05, 0.02)):
    """Poses near one [rad], [m]."""
    noise = np.random.default_rng(seed).normal(size=(n, 6)) * np.repeat(size, 3)
    return X_OH @ se3.exp(noise)


@pytest.mark.parametrize("n", [1, 5])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("corridor", [DIRECT, CORRIDOR], ids=["direct", "corridor"])
def test_gradient_by_finite_differences(n, seed, corridor):
    """The targets stay: by how much they are pulled back has no gradient."""
    X_WH, J_WH = pose_and_jacobian(Q, X_FG)
    X_OH = se3.inverse(X_WO) @ X_WH
    X_OG, share = scattered(X_OH, n, seed, size=(0.01, 0.004)), 0.5
    penalty = np.random.default_rng(seed).uniform(0.0, 2.0, n)
    X_OT = X_OG.copy()
    for each in X_OT:
        each[:3, 3] -= share * standoff_kernel(each, X_OH, corridor.parameters) * each[:3, 2]
    _, g = quadratic_form(X_WH, J_WH, X_OG, penalty, share=share, corridor=corridor)
    step = 1e-6
    ahead, behind = (
        [cost(pose_and_jacobian(Q + s * e, X_FG)[0], X_OT, penalty) for e in np.eye(7)]
        for s in (step, -step)
    )
    expected = np.subtract(ahead, behind) / (2 * step)
    assert np.linalg.norm(expected) > 1.0
    np.testing.assert_allclose(g, expected, atol=1e-5 * np.linalg.norm(expected))


@pytest.mark.parametrize("n", [1, 5])
@pytest.mark.parametrize("far", [0.0, 0.02, 0.5], ids=["near", "beside", "far"])
def test_the_quadratic_form_bounds_the_cost_from_above(n, far):
    """Where the joints move the hand along straight lines, from where both touch."""
    rng = np.random.default_rng(n)
    X_OH = se3.make_pose(se3.so3_exp([0.1, 0.4, -0.2]), [0.1, 0.02, 0.2])
    X_OG = scattered(X_OH, n, n)
    penalty = rng.uniform(0.0, 2.0, n)
    X_WH = X_WO @ X_OH
    X_WH[:3, 3] += far * np.array([0.6, 0.0, 0.8])
    H, g = quadratic_form(X_WH, SLIDES, X_OG, penalty)
    here, gaps = cost(X_WH, X_OG, penalty), []
    for size in (1e-4, 1e-3, 0.01, 0.1, 1.0):
        for _ in range(20):
            dq = np.append(size * rng.normal(size=3), np.zeros(4))
            moved = X_WH.copy()
            moved[:3, 3] += dq[:3]
            bound = here + g @ dq + 0.5 * dq @ H @ dq
            gaps.append(bound - cost(moved, X_OG, penalty))
    assert min(gaps) > -1e-9 * max(1.0, here)
    assert max(gaps) > 1.0  # it is no bound that holds anywhere


def test_far_errors_count_less():
    """In weight, not in pull: ``1 / (1 + d)`` of what they count near the grasp."""
    X_WH = X_WO.copy()
    H_near, _ = quadratic_form(X_WH, SLIDES, np.eye(4)[None], [0.0])
    X_WH[0, 3] += OPTIONS.tail_position  # d = 1
    H, g = quadratic_form(X_WH, SLIDES, np.eye(4)[None], [0.0])
    np.testing.assert_allclose(H, 0.5 * H_near, rtol=1e-12)
    np.testing.assert_allclose(g[:3], [OPTIONS.tail / OPTIONS.tail_position, 0.0, 0.0], atol=1e-9)


def test_grasps_without_weight_do_not_matter():
    X_WH, J_WH = pose_and_jacobian(Q, X_FG)
    X_OG = scattered(se3.inverse(X_WO) @ X_WH, 6, 0, size=(0.01, 0.004))
    alone = quadratic_form(X_WH, J_WH, X_OG[:1], [0.0])
    others = quadratic_form(X_WH, J_WH, X_OG, [0.0, *np.full(5, 1e4)])
    for one, other in zip(alone, others, strict=True):
        np.testing.assert_array_equal(one, other)
    equal = quadratic_form(X_WH, J_WH, X_OG, np.zeros(6))
    assert np.abs(equal[1] - alone[1]).max() > 1.0


@pytest.mark.parametrize("axis", range(6))
def test_half_way_between_two_equal_grasps_their_pulls_cancel(axis):
    X_WH, J_WH = pose_and_jacobian(Q, X_FG)
    X_OH, off = se3.inverse(X_WO) @ X_WH, 0.01 * np.eye(6)[axis]
    X_OG = X_OH @ se3.exp(np.array([off, -off]))
    H, g = quadratic_form(X_WH, J_WH, X_OG, [0.0, 0.0])
    H_alone, g_alone = quadratic_form(X_WH, J_WH, X_OG[:1], [0.0])
    np.testing.assert_allclose(g, 0.0, atol=1e-9 * np.abs(g_alone).max())
    np.testing.assert_allclose(H, H_alone, rtol=1e-9, atol=1e-9)
    # The cheaper of the two draws.
    _, g = quadratic_form(X_WH, J_WH, X_OG, [0.0, 1.0])
    assert g @ g_alone > 0.1 * g_alone @ g_alone


def test_it_adds_to_what_is_there_at_every_knot():
    X_WH, J_WH = (
        np.array(each)
        for each in zip(*(pose_and_jacobian(q, X_FG) for q in (Q, 0.9 * Q)), strict=True)
    )
    form = empty_form(2, 1.0)
    knots = knots_at([Q, 0.9 * Q], X_FG, [X_WO, X_WO])
    grasps = neighbours(np.eye(4)[None])
    density_kernel(knots, grasps, DIRECT.parameters, np.eye(4), OPTIONS.record, form)
    for k in range(2):
        H_one, g_one = quadratic_form(X_WH[k], J_WH[k], np.eye(4)[None], [0.0])
        np.testing.assert_allclose(form.H[k], 1.0 + H_one, rtol=1e-12)
        np.testing.assert_allclose(form.g[k], 1.0 + g_one, rtol=1e-12)
