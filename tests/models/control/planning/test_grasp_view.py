"""What a camera on the hand sees at a grasp, and what grasps are worth by that."""

import numpy as np
import pytest

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.control.planning.in_view import rated_by_view, share_in_view
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import FLIP, GraspSet

CAMERA = Camera((223.0, 216.0, 211.5, 119.5), 424, 240, near=0.07, depth_noise=0.02)
X_GC = se3.make_pose(se3.so3_exp([np.deg2rad(25.0), 0.0, 0.0]), [0.0, 0.085, -0.105])
#: A rod along the y-axis of the grasp, whose middle lies to one side of the hand.
ROD = np.column_stack([np.zeros(81), np.linspace(0.02, 0.3, 81), np.zeros(81)])


def ray_share(X_OG, points):
    """The same, point by point, by the angles from the camera's axis."""
    count = 0
    for p in points:
        x, y, z = (se3.inverse(X_OG @ X_GC) @ [*p, 1.0])[:3]
        wide, high = np.arctan2(abs(x), z), np.arctan2(abs(y), z)
        count += z > 0.07 and wide < np.arctan(212.0 / 223.0) and high < np.arctan(120.0 / 216.0)
    return count / len(points)


def test_the_share_is_that_of_the_points_inside_the_image():
    rng = np.random.default_rng(0)
    points = sphere_points(100, 0.05)
    for X_OG in se3.random_pose(rng, 10):
        X_OG[:3, 3] *= 0.1
        assert share_in_view(X_OG[None], points, X_GC, CAMERA)[0] == pytest.approx(
            ray_share(X_OG, points), abs=0.05
        )


def test_of_a_grasp_and_its_half_turn_the_one_that_sees_the_object_is_worth_more():
    X_OG = np.stack([np.eye(4), FLIP])
    grasps = GraspSet(X_OG, np.full(2, 0.03), np.full(2, 0.8))
    share = share_in_view(X_OG, ROD, X_GC, CAMERA)
    assert abs(share[0] - share[1]) > 0.1
    rated = rated_by_view(grasps, ROD, X_GC, CAMERA)
    assert np.argmax(rated.score) == np.argmax(share)
    assert rated.score[0] / rated.score[1] == pytest.approx(share[0] / share[1])
    near = rated_by_view(grasps, 0.2 * ROD, X_GC, CAMERA)  # which both see
    np.testing.assert_array_equal(near.score, grasps.score)
    np.testing.assert_array_equal(rated.X_OG, grasps.X_OG)


def test_what_sees_nothing_is_worth_little_and_not_nothing():
    behind = sphere_points(50, 0.03) - [0.0, 0.0, 0.6]
    grasps = GraspSet(np.eye(4)[None], [0.03], [0.8])
    assert rated_by_view(grasps, behind, X_GC, CAMERA).score[0] == pytest.approx(0.04)
    assert rated_by_view(GraspSet.empty(), behind, X_GC, CAMERA) is not None
