"""A hand on its way keeps farther off the object, by how far it is from lined up."""

import numpy as np
import pytest

from feasigrasp.models.control.planning.clearance_schedule import (
    scheduled_obstacle,
    step_back,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.models.shape.grids import object_grid

CORRIDOR, X_FG = ApproachCorridor(), ParallelGripper().X_FG
Q = np.array([0.1, 0.6, -0.2, -1.4, 0.3, 1.1, 0.4])
GRID = ObstacleGrid(np.zeros((2, 2, 2), dtype=np.float32), np.array([9.0, 9.0, 9.0, 0.01, 0.1]))
X_WO, V_WO = se3.random_pose(np.random.default_rng(3), 1)[0], np.arange(6.0)


def moving(*offsets, surface=GRID):
    """With grasps from which the hand is so far, in their own frames."""
    X_OH = se3.inverse(X_WO) @ forward_kinematics(Q, X_FG)
    grasps = [
        X_OH @ se3.inverse(se3.make_pose(se3.so3_exp(turn), position)) for position, turn in offsets
    ]
    return scheduled_obstacle(
        surface, Q, X_WO, V_WO, X_FG, np.reshape(grasps, (-1, 4, 4)), CORRIDOR
    )


LINED_UP = [0.0, 0.0, -0.05], [0.0, 0.0, 0.0]
NEAR = [0.013, 0.0, 0.0], [0.0, 0.0, 0.0]
FAR = [0.2, 0.0, 0.0], [0.0, 0.0, 2.0]


def test_the_reserve_is_that_of_the_grasp_that_the_hand_is_lined_up_with_best():
    """Nothing when lined up with any; a share of the least standoff; a centimetre far away."""
    assert moving(FAR, LINED_UP).extra_clearance == pytest.approx(0.0, abs=1e-12)
    assert moving(FAR, NEAR).extra_clearance == pytest.approx(0.2 * CORRIDOR.lateral_gain * 0.005)
    assert moving(FAR).extra_clearance == moving().extra_clearance == 0.01


def test_the_object_is_as_it_was_and_none_is_none():
    found = moving(FAR)
    assert found.grid is GRID and found.X_WO is X_WO and found.V_WO is V_WO
    assert moving(FAR, surface=None) is None


@pytest.fixture(scope="module")
def ball():
    """The grid of a ball of 3 cm."""
    return object_grid(fit_gpdf(sphere_points(400, 0.03)))


FLIPPED, HORIZON = ([0.0, 0.0, 0.0], [0.0, 0.0, np.pi]), ([0.0, 0.0, -0.03], [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("middle", "errors", "expected"),
    [
        ([0.0, 0.0, 0.0], [FLIPPED], True),
        ([0.0, 0.0, 0.0], [FLIPPED, FAR], True),
        ([0.0, 0.0, 0.0], [FLIPPED, HORIZON], False),
        ([0.0, 0.0, 0.0], [], False),
        ([0.0, 0.0, 0.08], [FLIPPED], False),
    ],
    ids=["other way round", "and far away", "lined up with one", "no grasp", "in front"],
)
def test_a_hand_is_astray_with_the_ball_between_its_fingers_but_for_no_grasp(
    ball, middle, errors, expected
):
    """The ball's middle is given in the hand's frame, and so are the errors of the grasps."""
    X_WH = forward_kinematics(Q, X_FG)
    X_WB = se3.make_pose(np.eye(3), X_WH[:3, :3] @ middle + X_WH[:3, 3])
    grasps = [
        se3.inverse(X_WB) @ X_WH @ se3.inverse(se3.make_pose(se3.so3_exp(turn), position))
        for position, turn in errors
    ]
    lost = np.full((4, 4), np.nan)
    for X_WO, misaligned in ((X_WB, expected), (lost, False)):
        found = scheduled_obstacle(
            ball, Q, X_WO, V_WO, X_FG, np.reshape(grasps, (-1, 4, 4)), CORRIDOR
        )
        assert found.misaligned is misaligned


def test_the_hand_steps_back_along_its_own_axis_seen_from_the_object():
    X_WH = forward_kinematics(Q, X_FG)
    V_WH, h = step_back(X_WH, X_WO, V_WO), 1e-6
    R = se3.so3_exp(h * V_WO[:3])
    X_WO_later = se3.make_pose(R @ X_WO[:3, :3], X_WO[:3, 3] + h * V_WO[3:])
    R = se3.so3_exp(h * V_WH[:3])
    X_WH_later = se3.make_pose(R @ X_WH[:3, :3], X_WH[:3, 3] + h * V_WH[3:])
    X_OH, later = se3.inverse(X_WO) @ X_WH, se3.inverse(X_WO_later) @ X_WH_later
    np.testing.assert_allclose(later[:3, :3], X_OH[:3, :3], atol=1e-9)
    np.testing.assert_allclose((later - X_OH)[:3, 3] / h, -0.15 * X_OH[:3, 2], atol=1e-5)
