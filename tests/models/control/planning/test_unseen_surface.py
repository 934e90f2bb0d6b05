"""Surface that nobody has seen keeps a hand off, unless it is on its way into a grasp in it."""

import numpy as np
import pytest

from feasigrasp.models.control.planning.clearance_schedule import obstacle_surface
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import MovingObject, ObstacleGrid
from feasigrasp.models.geometry.points import nearest_distance, sphere_points
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.models.shape.grids import object_grid

RADIUS = 0.06
GRIPPER = ParallelGripper()
HAND = GRIPPER.surface_points(GRIPPER.max_opening)
#: The hand points down.
Q = np.array([0.0, 0.55, 0.0, -1.6, 0.0, 0.99, 0.0])
X_WH = forward_kinematics(Q, GRIPPER.X_FG)
NOWHERE = np.full((4, 4), np.nan)


@pytest.fixture(scope="module")
def outside():
    """Points on the outside of a bowl, whose rim is at z = 0.02."""
    points = sphere_points(2000, RADIUS)
    return points[points[:, 2] < 0.02]


@pytest.fixture(scope="module")
def bowl(outside):
    """A bowl that was seen from below: the field fills it."""
    return object_grid(fit_gpdf(outside, length_scale=0.1, max_points=1200))


def test_a_shape_that_was_seen_all_round_is_all_there():
    ball = fit_gpdf(sphere_points(1200, 0.03), length_scale=0.1, max_points=1200)
    assert object_grid(ball).seen is None


def test_without_the_unseen_the_inside_of_a_bowl_is_as_far_as_its_wall(bowl, outside):
    inside = np.array([[0.0, 0.0, 0.015], [0.015, 0.01, 0.0], [0.0, -0.02, 0.01]])
    assert (bowl.distance_and_gradient(inside)[0] < 0.0).all()
    far = bowl.seen.distance_and_gradient(inside)[0]
    truth = np.minimum(nearest_distance(inside, outside), bowl.frame[4])
    np.testing.assert_allclose(far, truth, atol=0.004)


def test_what_was_seen_is_where_it_is_with_and_without_the_rest(bowl, outside):
    low = outside[outside[:, 2] < -0.02] * (1.0 + 0.012 / RADIUS)  # beside the seen wall
    distances = [each.distance_and_gradient(low)[0] for each in (bowl, bowl.seen)]
    np.testing.assert_allclose(distances[0], distances[1], atol=1e-6)
    np.testing.assert_allclose(distances[1], 0.012, atol=0.004)  # half a voxel


def bowl_with_hand_at(standoff, turn=0.0):
    """X_WO with the hand so far behind a grasp at the bowl's rim, and the grasp."""
    # One finger is in the bowl, the other beside it; the hand comes from above.
    X_OG = se3.make_pose(np.diag([1.0, -1.0, -1.0]), [RADIUS, 0.0, 0.01])
    behind = se3.make_pose(se3.so3_exp([0.0, 0.0, turn]), [0.0, 0.0, -standoff])
    return X_WH @ se3.inverse(X_OG @ behind), X_OG


def kept(bowl, X_WO, *grasps):
    return obstacle_surface(bowl, se3.inverse(X_WO) @ X_WH, np.reshape(grasps, (-1, 4, 4)), HAND)


def test_a_hand_on_its_way_into_the_unseen_keeps_off_the_seen(bowl):
    X_WO, X_OG = bowl_with_hand_at(0.06)
    assert kept(bowl, X_WO, X_OG) is bowl.seen
    beside = X_OG @ se3.exp([0.0, 0.0, 0.0, 0.0, 0.3, 0.0])
    assert kept(bowl, X_WO, beside, X_OG) is bowl.seen


@pytest.mark.parametrize(("standoff", "turn"), [(0.2, 0.0), (0.06, 0.6)])
def test_a_hand_far_from_its_grasp_keeps_off_all(bowl, standoff, turn):
    X_WO, X_OG = bowl_with_hand_at(standoff, turn)
    assert kept(bowl, X_WO, X_OG) is bowl


def test_a_grasp_that_nothing_is_in_the_way_of_changes_nothing(bowl):
    X_WO, X_OG = bowl_with_hand_at(0.03)
    above = X_OG @ se3.exp([0.0, 0.0, 0.0, 0.0, 0.0, -0.1])
    assert kept(bowl, X_WO, above) is bowl
    assert kept(bowl, X_WO) is bowl
    assert kept(bowl, NOWHERE, X_OG) is bowl
    known = ObstacleGrid(bowl.values, bowl.frame)
    assert kept(known, X_WO, X_OG) is known


def way_in(surface):
    """How far from its grasp at the rim a hand comes to rest that goes straight there [m]."""
    X_WO, X_OG = bowl_with_hand_at(0.06)
    safety, q, qd = SafetyFilter(SafetyOptions()), Q, np.zeros(7)
    for _ in range(600):
        X, J = pose_and_jacobian(q, GRIPPER.X_FG)
        way = (X_WO @ X_OG)[:3, 3] - X[:3, 3]
        moving = MovingObject(surface(q, X_WO, X_OG), X_WO, np.zeros(6))
        twist = np.concatenate([np.zeros(3), 3.0 * way])
        qd = safety.velocity(q, np.zeros(7), J, twist, qd_last=qd, moving=moving)
        q = q + 0.005 * qd
    return np.linalg.norm(way)


def test_so_it_comes_to_a_grasp_that_it_would_hover_before(bowl):
    def chosen(q, X_WO, X_OG):
        X_OH = se3.inverse(X_WO) @ forward_kinematics(q, GRIPPER.X_FG)
        return obstacle_surface(bowl, X_OH, X_OG[None], HAND)

    assert way_in(lambda *_: bowl) > 0.02
    assert way_in(chosen) < 0.002
