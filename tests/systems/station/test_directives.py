"""A hand of one's own in the cell: its model is the one that its description says."""

import numpy as np
import pytest

from feasigrasp.errors import GraspError, ScenarioError
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import GRIPPERS, PACKAGED, WSG_50, load_gripper
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.reference_robot import reference_robot
from feasigrasp.scenario import load_scenario
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.cell_check import check_cell
from feasigrasp.systems.station.directives import cell_directives

FILE = diagram_path("dynamic.scenarios.yaml")


def scenario(gripper):
    return load_scenario(FILE, "ReachLinearMocap", f"{{gripper: {gripper}}}")


@pytest.fixture(scope="module")
def station():
    return make_station(scenario("WSG_50"))


def boxes_of(hand, opening):
    """Corners of the boxes that a description names, by body, in the grasp frame."""
    length, out = hand.tip - hand.heel, (opening + hand.finger_thickness) / 2
    finger = np.array([hand.finger_thickness, hand.finger_width, length])
    palm = np.array(hand.palm_size)
    middle = {
        "left_finger": (finger, [out, 0.0, hand.tip - length / 2]),
        "right_finger": (finger, [-out, 0.0, hand.tip - length / 2]),
        "gripper_body": (palm, [0.0, 0.0, hand.heel - palm[2] / 2]),
    }
    return {name: (c - size / 2, c + size / 2) for name, (size, c) in middle.items()}


def test_the_simulated_hand_is_the_described_one(station):
    """What collides of every body spans its box, in the grasp frame that is planned with."""
    plant = station.plant
    check_cell(plant, WSG_50)
    context = station.CreateDefaultContext()
    hand = plant.GetModelInstanceByName("gripper")
    plant_context = plant.GetMyContextFromRoot(context)
    X_GW = plant.GetFrameByName("grasp_frame").CalcPoseInWorld(plant_context).inverse()
    query = station.GetOutputPort("query_object").Eval(context)
    for name, (low, high) in boxes_of(WSG_50, WSG_50.max_opening).items():
        corners = []
        for geometry in plant.GetCollisionGeometriesForBody(plant.GetBodyByName(name, hand)):
            box = query.ComputeObbInWorld(geometry)
            half = box.half_width()
            for signs in np.ndindex(2, 2, 2):
                p_W = box.pose() @ (half * (2 * np.array(signs) - 1))
                corners.append(X_GW @ p_W)
        np.testing.assert_allclose(np.min(corners, axis=0), low, atol=1.1e-3, err_msg=name)
        np.testing.assert_allclose(np.max(corners, axis=0), high, atol=1.1e-3, err_msg=name)


def test_the_camera_sits_where_the_description_has_it(station):
    plant, context = station.plant, station.plant.CreateDefaultContext()
    X_GC = plant.GetFrameByName("camera_body").CalcPose(
        context, plant.GetFrameByName("grasp_frame")
    )
    np.testing.assert_allclose(X_GC.translation(), WSG_50.camera_center, atol=1e-9)
    axis = X_GC.rotation().matrix()[:, 2]  # leans to the tool axis, which lies at smaller y
    tilt = WSG_50.camera_tilt
    np.testing.assert_allclose(axis, [0.0, -np.sin(tilt), np.cos(tilt)], atol=1e-9)


def test_runs_are_judged_by_the_same_hand():
    """The visible fingers of the twin are as far apart as the hand opens."""
    reference = reference_robot(cell_directives(scenario("WSG_50")))
    context = reference.plant.CreateDefaultContext()
    hand = reference.plant.GetModelInstanceByName("gripper")
    upper = reference.plant.GetPositionsFromArray(hand, reference.plant.GetPositionUpperLimits())
    reference.plant.SetPositions(context, hand, upper)
    left, right = (
        reference.plant.GetBodyByName(f"{side}_finger").EvalPoseInWorld(context).translation()
        for side in ("left", "right")
    )
    assert np.linalg.norm(left - right) == pytest.approx(WSG_50.max_opening)


def test_the_packaged_hand_leaves_the_directives_as_they_are():
    packaged = scenario(PACKAGED)
    assert cell_directives(packaged) is packaged.directives


def test_a_file_changes_what_it_says(tmp_path):
    file = tmp_path / "hand.yaml"
    file.write_text("max_opening: 0.1\npalm_size: [0.08, 0.07, 0.06]\n")
    hand = load_gripper(str(file))
    assert hand.max_opening == 0.1 and hand.palm_size == (0.08, 0.07, 0.06)
    assert hand.tip == ParallelGripper().tip
    assert load_gripper("WSG_50") is GRIPPERS["WSG_50"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("max_openning: 0.1", "max_openning.*do you mean max_opening"),
        ("max_opening: 110", "max_opening = 110.* above 0 of at most 1 m"),
        ("max_opening: wide", "hand.yaml: .*max_opening is 'wide'; give a finite number"),
        ("palm_size: [0.1, 0.1]", "palm_size is .*; give 3 entries"),
        ("just words", "hand.yaml: not a mapping; give keys"),
        ("{tip: 0.02, tip: 0.03}", "hand.yaml: the key 'tip' is given twice, in line 1"),
        ("{", "hand.yaml: not valid YAML: .*line 1"),
    ],
)
def test_a_file_that_describes_no_hand_is_refused(text, message, tmp_path):
    file = tmp_path / "hand.yaml"
    file.write_text(text)
    with pytest.raises(GraspError, match=message):
        load_gripper(str(file))
    with pytest.raises(ScenarioError, match=message):
        scenario(file)


def test_a_misspelt_name_is_refused_with_the_right_one():
    with pytest.raises(ScenarioError, match="'WSG50'.*do you mean WSG_50"):
        scenario("WSG50")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("max_opening: 85 mm", "max_opening is '85 mm'; give a finite number"),
        ("max_opening: [0.1]", "max_opening is a tuple; give a finite number"),
        ("max_opening:", "max_opening is None; give a finite number"),
        ("palm_size: 0.1", "palm_size is 0.1; give 3 entries"),
        ("tip: true", "tip is True; give a finite number"),
        ("camera_tilt: 15", "camera_tilt = 15: give an angle in radians"),
        ("camera_tilt: .nan", "camera_tilt = nan; give a finite number"),
        ("camera_center: [85, 0, 0]", "camera_center = .*give x, y, z in metres"),
    ],
)
def test_wrong_units_and_types_of_a_hand_are_named(text, message, tmp_path):
    file = tmp_path / "hand.yaml"
    file.write_text(text)
    with pytest.raises(GraspError, match=f"hand.yaml: .*{message}"):
        load_gripper(str(file))


def test_fingers_as_thin_as_their_pads_cannot_be_simulated(tmp_path):
    file = tmp_path / "hand.yaml"
    file.write_text("finger_thickness: 0.006")
    with pytest.raises(GraspError, match=r"finger_thickness = 0\.006: .* more than .* 0\.006 m"):
        make_station(scenario(str(file)))
