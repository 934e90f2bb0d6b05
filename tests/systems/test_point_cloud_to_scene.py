"""Surroundings from a camera's images."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene

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


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(PointCloudToScene([1]))
    assert (list(inputs), list(outputs)) == documented_ports(PointCloudToScene)


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


def test_what_flies_between_hand_and_table_is_no_part_of_the_scene(fixed_context):
    """At the edge of the robot a camera mixes its depth with that of the table behind."""
    dut = PointCloudToScene([ROBOT, OBJECT])
    view = table_view(0.0)
    points = view["point_cloud"].mutable_xyzs().reshape(3, 40, 60)
    points[2, 20:30, 50] = 0.15  # labelled as the table, half way up to the robot
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    for name, value in view.items():
        dut.GetInputPort(name).FixValue(context, value)
    simulator.AdvanceTo(0.1)
    scene = dut.get_output_port().Eval(context)
    assert scene.distance(np.array([[0.5, 0.25, 0.15]]))[0] > 0.12


def test_nothing_seen_changes_nothing(fixed_context):
    dut = PointCloudToScene([TABLE, ROBOT, OBJECT])
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    for name, value in table_view(0.0).items():
        dut.GetInputPort(name).FixValue(context, value)
    simulator.AdvanceTo(0.1)
    assert dut.get_output_port().Eval(context) is None


def test_in_the_whole_diagram_the_scene_is_the_table():
    """The camera looks at object and hand; what it sees beside them is the table top, z = 0."""
    text = "{scene: {enabled: true}, simulation_duration: 0.1, camera_noise: {}}"
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
