"""The table of connections: who feeds whom, and that nothing of it is stale."""

import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from feasigrasp.resources import diagram_path
from feasigrasp.scenario import load_scenario
from feasigrasp.systems import make_dynamic_grasp
from feasigrasp.systems.wiring import CONNECTIONS, connect_all


def ports(*inputs, outputs=()):
    """A system with ports of one number each."""
    system = LeafSystem()
    for name in inputs:
        system.DeclareVectorInputPort(name, 1)
    for name in outputs:
        system.DeclareVectorOutputPort(name, 1, lambda context, output: None)
    return system


def connected(systems, signals=(), cameras=()):
    """By ``system.input`` the ``system.output`` that it is connected to."""
    builder = DiagramBuilder()
    for name, system in systems.items():
        builder.AddNamedSystem(name, system)
    given = {
        name: systems[source].GetOutputPort(port) for name, (source, port) in dict(signals).items()
    }
    connect_all(builder, given, dict(cameras))
    return {
        f"{to.get_name()}.{to.get_input_port(i).get_name()}": (
            f"{source.get_name()}.{source.get_output_port(o).get_name()}"
        )
        for (to, i), (source, o) in builder.connection_map().items()
    }


def test_the_first_source_that_there_is_counts():
    latency, carrying = ports(outputs=["y"]), ports("grasps", outputs=["grasps"])
    found = connected({"latency": latency, "reachability": ports("grasps")})
    assert found == {"reachability.grasps": "latency.y"}
    latency = ports(outputs=["y"])
    found = connected({"latency": latency, "carrying": carrying, "reachability": ports("grasps")})
    assert found == {"reachability.grasps": "carrying.grasps", "carrying.grasps": "latency.y"}


def test_cameras_and_signals_are_found_by_their_short_names():
    station = ports(outputs=["left.pose", "left.point_cloud"])
    systems = {"station": station, "fault_0": ports(outputs=["point_cloud"])}
    systems["scene_perception"] = ports("point_cloud", "camera_pose")
    found = connected(systems, {"cloud": ("fault_0", "point_cloud")}, {"camera": "left"})
    assert found == {
        "scene_perception.point_cloud": "fault_0.point_cloud",
        "scene_perception.camera_pose": "station.left.pose",
    }


def test_an_input_of_ones_own_controller_is_found_by_name():
    systems = {"tracker": ports(outputs=["spin"]), "controller": ports("spin", "mine")}
    assert connected(systems) == {"controller.spin": "tracker.spin"}


def test_other_systems_are_left_alone():
    assert connected({"tracker": ports(outputs=["spin"]), "mine": ports("spin")}) == {}


@pytest.mark.parametrize("execution", ["inline", "processes"])
def test_the_whole_diagram_has_what_the_table_names(execution):
    """With a wall, by the camera; in one process and in several."""
    text = f"{{perception: {{execution: {execution}}}}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachObstacle", text)
    diagram = make_dynamic_grasp(scenario)
    names = {system.get_name() for system in diagram.GetSystems()}
    made = {
        (system.get_name(), system.get_input_port(port).get_name())
        for system, port in diagram.connection_map()
    }
    for name in names & CONNECTIONS.keys():
        system = diagram.GetSubsystemByName(name)
        for port in CONNECTIONS[name]:
            assert not system.HasInputPort(port) or (name, port) in made or port in OPTIONAL, port


#: Inputs that stay open in these diagrams.
OPTIONAL = {
    *("color_image", "image_time", "track", "arrival", "lapsed", "plan", "static_obstacles"),
    *("second_point_cloud", "second_depth_image", "second_image_time", "second_camera_pose"),
    *("second_color_image", "second_position", "stamp", "frame_pose"),
}
