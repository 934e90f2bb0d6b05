"""Surroundings from a camera's images, and the grasps that keep clear of them."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import fit_scene
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene, SceneFilter

ROBOT, OBJECT, TABLE = 3, 9, 12
X_WC = RigidTransform([0.4, 0.0, 1.0])


def table_view(y):
    """A strip of table top (z = 0) at some y, an object on it, a robot link above, and nothing."""
    u, v = np.meshgrid(np.arange(60), np.arange(40))
    points = np.stack([0.01 * u, y + 0.01 * v, np.zeros(u.shape)]).astype(np.float32)
    labels = np.full(u.shape, TABLE)
    points[2, 10:15, 10:15], labels[10:15, 10:15] = 0.1, OBJECT
    points[2, 20:30, 40:50], labels[20:30, 40:50] = 0.3, ROBOT
    points[:, :3] = np.inf
    cloud = PointCloud(u.size)
    cloud.mutable_xyzs()[:] = points.reshape(3, -1)
    image = ImageLabel16I(u.shape[1], u.shape[0])
    image.mutable_data[:, :, 0] = labels
    return {"point_cloud": cloud, "label_image": image, "camera_pose": X_WC}


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


@pytest.mark.parametrize("dut", [PointCloudToScene([1]), SceneFilter(ParallelGripper())])
def test_ports_are_those_of_the_docstring(dut, ports, documented_ports):
    inputs, outputs = ports(dut)
    assert (list(inputs), list(outputs)) == documented_ports(type(dut))


def test_robot_and_object_are_no_part_of_the_scene_and_views_are_merged(fixed_context):
    dut = PointCloudToScene([ROBOT, OBJECT], period=0.5)
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    assert dut.get_output_port().Eval(context) is None
    for y in (0.0, 0.4):
        for name, value in table_view(y).items():
            dut.GetInputPort(name).FixValue(context, value)
        simulator.AdvanceTo(context.get_time() + 0.5)
        scene = dut.get_output_port().Eval(context)
    probe = np.array([[0.3, 0.25, 0.1], [0.45, 0.6, 0.1], [0.12, 0.12, 0.15], [0.45, 0.25, 0.35]])
    np.testing.assert_allclose(scene.distance(probe[:2]), 0.1, atol=2e-3)
    assert scene.distance(probe[2:])[0] > 0.14  # the table below the object, not the object
    assert scene.distance(probe[2:])[1] > 0.33


def test_nothing_seen_changes_nothing(fixed_context):
    dut = PointCloudToScene([TABLE, ROBOT, OBJECT])
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    for name, value in table_view(0.0).items():
        dut.GetInputPort(name).FixValue(context, value)
    simulator.AdvanceTo(0.1)
    assert dut.get_output_port().Eval(context) is None


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


def test_in_the_whole_diagram_the_scene_is_the_table():
    """The camera looks at object and hand; what it sees beside them is the table top, z = 0."""
    text = "{scene: {enabled: true}, simulation_duration: 0.1}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinear", text)
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.06)
    perceived = diagram.GetSubsystemByName("scene_perception")
    context = perceived.GetMyContextFromRoot(simulator.get_context())
    scene = perceived.get_output_port().Eval(context)
    assert np.median(np.abs(scene.points[:, 2])) < 1e-3
    for name in ("clear_grasps", "clear_hand_poses"):
        system = diagram.GetSubsystemByName(name)
        grasps = system.get_output_port().Eval(system.GetMyContextFromRoot(simulator.get_context()))
        assert isinstance(grasps, GraspSet)
