"""Which systems read what only a simulation can know."""

import pytest

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from tests.pipeline import SECOND_CAMERA

FILE = diagram_path("dynamic.scenarios.yaml")
#: Those that measure, and hand on nothing to what they measure.
JUDGES = {"metrics", "true_frame", "true_pose_at_view", "contact", "obstacle_distance"}


def is_truth(port):
    """Whether a port of the station is one that no real cell has."""
    return port.endswith("label_image") or port in (
        *("object.pose", "object.velocity", "object.let_go", "contact_results", "query_object"),
    )


def readers(diagram):
    """By port of truth, the systems that read it, and those that read a judge."""
    found = {}
    for (system, _), (source, output) in diagram.connection_map().items():
        port = source.get_output_port(output).get_name()
        if source.get_name() == "station" and is_truth(port):
            found.setdefault(port, set()).add(system.get_name())
        elif source.get_name() in JUDGES:
            found.setdefault("judges", set()).add(system.get_name())
    return found


def test_judges_tell_nobody_but_logs_and_each_other():
    found = readers(make_dynamic_grasp(load_scenario(FILE, "ReachLinearMocap")))
    others = {name for name in found["judges"] - JUDGES if not name.startswith("log(")}
    assert not others
    assert "segmentation" in found["wrist_camera.label_image"]
    assert "tracker" in found["object.pose"]


@pytest.mark.parametrize(
    ("name", "controller"),
    [
        ("ReachLinear", "task"),
        ("ReachLinear", "joint"),
        ("ReachLinearCarried", "task"),
        ("ReachLinearAlong", "task"),
    ],
)
def test_with_the_camera_alone_only_judges_read_truth(name, controller):
    text = f"{{control: {{controller: {controller}}}}}"
    found = readers(make_dynamic_grasp(load_scenario(FILE, name, text)))
    assert "wrist_camera.label_image" not in found
    assert set.union(*(found[port] for port in found if port != "judges")) <= JUDGES
    assert found["object.pose"] == {"metrics", "true_frame", "true_pose_at_view"}
    assert not {name for name in found["judges"] - JUDGES if not name.startswith("log(")}


@pytest.mark.parametrize("scene", ["true", "false"])
def test_with_segmentation_by_depth_nobody_reads_the_label_image(scene):
    text = f"{{tracker: {{kind: mocap}}, scene: {{enabled: {scene}}}}}"
    found = readers(make_dynamic_grasp(load_scenario(FILE, "ReachLinear", text)))
    assert "wrist_camera.label_image" not in found
    assert found["object.pose"] - JUDGES == {"tracker"}
    assert found["contact_results"] <= JUDGES and found["query_object"] <= JUDGES


def test_nor_does_a_second_camera_tell_it():
    found = readers(make_dynamic_grasp(load_scenario(FILE, "ReachLinear", SECOND_CAMERA)))
    assert "side_camera.label_image" not in found
    assert found["object.pose"] == {"metrics", "true_frame", "true_pose_at_view"}
