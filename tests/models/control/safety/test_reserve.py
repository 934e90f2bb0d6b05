"""A hand on its way keeps farther off the object, by how far it is from lined up."""

import numpy as np
import pytest

from feasigrasp.models.control.safety.obstacle_grid import ObstacleGrid
from feasigrasp.models.control.safety.reserve import kept_off
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.funnel import Funnel
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics

FUNNEL, X_FG = Funnel(), ParallelGripper().X_FG
Q = np.array([0.1, 0.6, -0.2, -1.4, 0.3, 1.1, 0.4])
GRID = ObstacleGrid(np.zeros((2, 2, 2), dtype=np.float32), np.zeros(5))
X_WO, V_WO = se3.random_pose(np.random.default_rng(3), 1)[0], np.arange(6.0)


def moving(*offsets, surface=GRID):
    """With grasps from which the hand is so far, in their own frames."""
    X_OH = se3.inverse(X_WO) @ forward_kinematics(Q, X_FG)
    grasps = [
        X_OH @ se3.inverse(se3.make_pose(se3.so3_exp(turn), position)) for position, turn in offsets
    ]
    return kept_off(surface, Q, X_WO, V_WO, X_FG, np.reshape(grasps, (-1, 4, 4)), FUNNEL)


LINED_UP = [0.0, 0.0, -0.05], [0.0, 0.0, 0.0]
NEAR = [0.013, 0.0, 0.0], [0.0, 0.0, 0.0]
FAR = [0.2, 0.0, 0.0], [0.0, 0.0, 2.0]


def test_the_reserve_is_that_of_the_grasp_that_the_hand_is_lined_up_with_best():
    """Nothing when lined up with any; a share of the least standoff; a centimetre far away."""
    assert moving(FAR, LINED_UP).reserve == pytest.approx(0.0, abs=1e-12)
    assert moving(FAR, NEAR).reserve == pytest.approx(0.2 * FUNNEL.lateral_gain * 0.005)
    assert moving(FAR).reserve == moving().reserve == 0.01


def test_the_object_is_as_it_was_and_none_is_none():
    found = moving(FAR)
    assert found.grid is GRID and found.X_WO is X_WO and found.V_WO is V_WO
    assert moving(FAR, surface=None) is None
