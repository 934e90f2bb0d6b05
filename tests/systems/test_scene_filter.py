"""Grasps that keep clear of a table, and those that do not."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import fit_scene
from feasigrasp.systems.reachability_filter import SceneFilter


def grasp_set(*poses):
    return GraspSet(np.array(poses), np.full(len(poses), 0.05), np.ones(len(poses)))


def downwards(z, flipped=False):
    X = np.eye(4)
    X[:3, :3] = np.diag([1.0, -1.0, -1.0])
    X[:3, 3] = [0.3, 0.2, z]
    return X @ np.diag([-1.0, -1.0, 1.0, 1.0]) if flipped else X


@pytest.fixture(scope="module")
def scene():
    x, y = np.meshgrid(np.arange(0.0, 0.6, 0.01), np.arange(0.0, 0.4, 0.01))
    return fit_scene(np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]), [0.3, 0.2, 1.0])


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(SceneFilter(ParallelGripper()))
    assert (list(inputs), list(outputs)) == documented_ports(SceneFilter)


def test_grasps_in_the_table_are_dropped_at_the_objects_pose(scene, fixed_context):
    dut = SceneFilter(ParallelGripper())
    grasps = grasp_set(downwards(0.1), downwards(0.0))
    for lift, kept in ((0.0, [0]), (0.05, [0, 1]), (-0.1, [])):
        context = fixed_context(
            dut, grasps=grasps, object_pose=RigidTransform([0.0, 0.0, lift]), scene=scene
        )
        left = dut.get_output_port().Eval(context)
        np.testing.assert_array_equal(left.X_OG, grasps.X_OG[kept])
        assert left.rejected.get("hits the scene", 0) == 2 - len(kept)


@pytest.mark.parametrize("either", [False, True])
def test_where_the_object_is_unknown_no_grasp_is_known_to_be_clear(scene, fixed_context, either):
    dut = SceneFilter(ParallelGripper(), either_way_round=either)
    grasps = grasp_set(downwards(0.1), downwards(0.2))
    unknown = RigidTransform(np.full((4, 4), np.nan))
    context = fixed_context(dut, grasps=grasps, object_pose=unknown, scene=scene)
    left = dut.get_output_port().Eval(context)
    assert len(left) == 0
    assert left.rejected == {"the object's pose is unknown": 2}


def test_without_a_scene_all_grasps_stay(fixed_context):
    dut, grasps = SceneFilter(ParallelGripper()), grasp_set(downwards(0.0))
    context = fixed_context(dut, grasps=grasps, object_pose=RigidTransform(), scene=None)
    assert len(dut.get_output_port().Eval(context)) == 1


def test_either_way_round_keeps_what_half_a_turn_makes_clear(scene, fixed_context):
    """Hand level above the table: the camera beside the palm hits it one way round only."""
    X = np.eye(4)
    X[:3, :3] = np.column_stack([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    X[:3, 3] = [0.3, 0.2, 0.06]  # y, on whose side the camera is, points up
    low = X @ np.diag([-1.0, -1.0, 1.0, 1.0])
    for either, kept in ((False, 1), (True, 2)):
        dut = SceneFilter(ParallelGripper(), either_way_round=either)
        context = fixed_context(
            dut, grasps=grasp_set(X, low), object_pose=RigidTransform(), scene=scene
        )
        assert len(dut.get_output_port().Eval(context)) == kept
