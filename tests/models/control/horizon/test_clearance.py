"""The object's clearance in a plan against the hinge written out, by finite differences."""

import numpy as np
import pytest

from feasigrasp.models.control.horizon.clearance import clearance_kernel
from feasigrasp.models.control.horizon.knots import Surface
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from tests.plan_knots import empty_form, knots_at, neighbours

GRIPPER, CORRIDOR = ParallelGripper(), ApproachCorridor()
HAND = GRIPPER.surface_points(GRIPPER.max_opening)
Q = np.array([0.1, 0.5, 0.1, -1.5, 0.1, 1.0, 0.1])
WEIGHT, CLEARANCE, RADIUS = 100.0, 0.03, 0.04
#: Lined up with the grasp, nothing is added to the clearance.
X_OG = se3.make_pose(se3.so3_exp([3.0, 0.2, 0.1]), [0.0, 0.0, 0.06])


@pytest.fixture(scope="module")
def ball():
    """Its distances at nodes 2 mm apart, up to 5 cm from it."""
    ticks = np.arange(-0.09, 0.091, 0.002)
    nodes = np.stack(np.meshgrid(ticks, ticks, ticks, indexing="ij"), axis=-1)
    values = np.linalg.norm(nodes, axis=-1) - RADIUS
    return ObstacleGrid(values.astype(np.float32), np.array([-0.09, -0.09, -0.09, 0.002, 0.05]))


def object_pose():
    """Where the ball is if the hand at Q is at the grasp."""
    return pose_and_jacobian(Q, GRIPPER.X_FG)[0] @ se3.inverse(X_OG)


def quadratic_form(q, X_WO, ball, *, clearance=CLEARANCE, corridor=CORRIDOR):
    knots, form = knots_at(q[None], GRIPPER.X_FG, X_WO[None]), empty_form()
    surface = Surface(HAND, ball.values, ball.frame, clearance)
    clearance_kernel(knots, neighbours(X_OG[None]), surface, corridor.parameters, WEIGHT, form)
    return form.H[0], form.g[0]


def missing(q, X_WO, clearance=CLEARANCE):
    """By how much the points of the hand are too near to the true ball (k,)."""
    X_WH = pose_and_jacobian(q, GRIPPER.X_FG)[0]
    p_WQ = HAND @ X_WH[:3, :3].T + X_WH[:3, 3]
    return np.maximum(0.0, clearance + RADIUS - np.linalg.norm(p_WQ - X_WO[:3, 3], axis=1))


def test_gradient_and_hessian_are_those_of_the_hinge(ball):
    """Gauss-Newton's Hessian: the squared slopes of what is missing."""
    X_WO, step = object_pose(), 1e-5
    short = missing(Q, X_WO)
    assert 5 < (short > 0.0).sum() < len(HAND)
    slopes = np.array(
        [
            (missing(Q + step * e, X_WO) - missing(Q - step * e, X_WO)) / (2 * step)
            for e in np.eye(7)
        ]
    )
    H, g = quadratic_form(Q, X_WO, ball)
    expected, full = WEIGHT * slopes @ short, WEIGHT * slopes @ slopes.T
    np.testing.assert_allclose(g, expected, atol=0.01 * np.abs(expected).max())
    np.testing.assert_allclose(H, full, atol=0.01 * np.abs(full).max())
    assert np.linalg.norm(g) > 0.1


def test_nothing_is_added_where_the_clearance_is_kept(ball):
    X_WO = object_pose()
    H, g = quadratic_form(Q, X_WO, ball, clearance=-0.05)
    assert not H.any() and not g.any()
    X_WO[2, 3] += 1.0
    H, g = quadratic_form(Q, X_WO, ball)
    assert not H.any() and not g.any()


def test_a_hand_that_is_not_lined_up_keeps_farther_off(ball):
    X_WO, q = object_pose(), Q + np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.8])
    plain = ApproachCorridor(max_standoff=0.0)
    for each, farther in ((Q, False), (q, True)):
        H, g = quadratic_form(each, X_WO, ball)
        H_plain, g_plain = quadratic_form(each, X_WO, ball, corridor=plain)
        assert (np.trace(H) > 1.1 * np.trace(H_plain)) == farther
        assert (np.linalg.norm(g) > 1.1 * np.linalg.norm(g_plain)) == farther
