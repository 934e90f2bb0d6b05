"""Surroundings from a camera's images."""

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import PointCloud
from pydrake.systems.analysis import Simulator
from pydrake.systems.sensors import ImageLabel16I

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.capsules import arm_balls
from feasigrasp.models.shape.grids import obstacle_grid
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.point_cloud_to_scene import PointCloudToScene
from feasigrasp.systems.ports import evaluate
from feasigrasp_lab.arm import IIWA_CAPSULES

ROBOT, OBJECT, TABLE = 3, 9, 12


def table_view(y, box=False, flying=False):
    """From 1 m above, a strip of table top (z = 0) at some y; an object on it, a robot link above.

    Some pixels show nothing. There may be a box on the table, 5 cm high; and pixels that fly
    between robot and table.
    """
    u, v = np.meshgrid(np.arange(60), np.arange(40))
    height, labels = np.zeros(u.shape), np.full(u.shape, TABLE)
    height[10:15, 10:15], labels[10:15, 10:15] = 0.1, OBJECT
    height[20:30, 40:50], labels[20:30, 40:50] = 0.3, ROBOT
    if box:
        height[10:20, 25:35] = 0.05
    if flying:
        height[20:30, 50] = 0.15  # labelled as the table
    p_WC = np.array([0.3, y + 0.2, 1.0])
    depth = p_WC[2] - height
    points = np.stack(
        [p_WC[0] + 0.01 * (u - 30) * depth, p_WC[1] + 0.01 * (v - 19.5) * depth, height]
    )
    points[:, :3] = np.inf
    cloud = PointCloud(u.size)
    cloud.mutable_xyzs()[:] = points[:, ::-1].reshape(3, -1)  # rows go downwards, along -y
    image = ImageLabel16I(u.shape[1], u.shape[0])
    image.mutable_data[:, :, 0] = labels[::-1]
    X_WC = RigidTransform(RotationMatrix.MakeXRotation(np.pi), p_WC)
    return {"point_cloud": cloud, "label_image": image, "camera_pose": X_WC}


def looked(dut, *views, **inputs):
    """The scene after some views, one after the other."""
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    for view in views:
        for name, value in (view | inputs).items():
            dut.GetInputPort(name).FixValue(context, value)
        simulator.AdvanceTo(context.get_time() + 1.0)
    return evaluate(dut.get_output_port(), context)


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(PointCloudToScene([1]))
    assert (list(inputs), list(outputs)) == documented_ports(PointCloudToScene)


def test_robot_and_object_are_no_part_of_the_scene_and_views_are_merged():
    dut = PointCloudToScene([ROBOT, OBJECT])
    assert evaluate(dut.get_output_port(), dut.CreateDefaultContext()) is None
    scene = looked(dut, table_view(0.0), table_view(0.4))
    probe = np.array([[0.3, 0.25, 0.1], [0.45, 0.6, 0.1], [0.12, 0.12, 0.15], [0.45, 0.25, 0.35]])
    np.testing.assert_allclose(scene.distance(probe[:2]), 0.1, atol=2e-3)
    assert scene.distance(probe[2:])[0] > 0.14  # the table below the object, not the object
    assert scene.distance(probe[2:])[1] > 0.33


def test_what_flies_between_hand_and_table_is_no_part_of_the_scene():
    """At the edge of the robot a camera mixes its depth with that of the table behind."""
    scene = looked(PointCloudToScene([ROBOT, OBJECT]), table_view(0.0, flying=True))
    assert scene.distance(np.array([[0.47, 0.25, 0.15]]))[0] > 0.12


def test_nothing_seen_changes_nothing():
    assert looked(PointCloudToScene([TABLE, ROBOT, OBJECT]), table_view(0.0)) is None
    blind = table_view(0.0)
    blind["point_cloud"].mutable_xyzs()[:] = np.inf
    assert looked(PointCloudToScene([ROBOT, OBJECT]), blind) is None


def test_what_has_been_taken_away_has_gone():
    dut = PointCloudToScene([ROBOT, OBJECT])
    top = np.array([[0.3, 0.15, 0.05]])
    assert abs(looked(dut, table_view(0.0, box=True)).distance(top)[0]) < 0.01
    assert looked(dut, table_view(0.0, box=True), table_view(0.0)).distance(top)[0] > 0.04


def test_the_table_may_go_on_where_nobody_has_looked_but_not_in_the_arm():
    """Beside the strip that was seen, in its plane and below; above it nothing is in the way."""
    view = table_view(0.0)
    dut = PointCloudToScene([ROBOT, OBJECT])
    beside = np.array([[0.3, -0.1, 0.0], [0.3, 0.2, -0.05]])
    air = np.array([[0.3, 0.2, 0.1], [0.3, -0.1, 0.1]])
    scene = looked(dut, view)
    assert (scene.unobserved_distance(beside) < 0.0).all()
    assert (scene.unobserved_distance(air) > 0.05).all()
    grid = obstacle_grid(scene)
    assert (grid.distance_and_gradient(beside)[0] < 0.02).all()
    q = np.array([0.0, 1.8, 0.0, -1.0, 0.0, 0.5, 0.0])  # the hand reaches down beside the strip
    balls = arm_balls(IIWA_CAPSULES)
    center = balls.placed(q)
    assert np.min(scene.unobserved_distance(center) - balls.radius) < 0.0
    around = looked(dut, view, position=q).unobserved
    least = np.linalg.norm(around[:, None] - center, axis=2) - balls.radius
    assert least.min() > 0.0


def test_in_the_whole_diagram_the_scene_is_the_table():
    """The camera looks at object and hand; what it sees beside them is the table top, z = 0."""
    text = "{scene: {enabled: true}, simulation_duration: 0.1, camera_noise: {}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", text)
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
