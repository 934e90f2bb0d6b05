"""Cells that are not the one computed with are refused, by part, amount and mend."""

import pytest
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import LoadModelDirectives, Parser
from pydrake.multibody.plant import MultibodyPlant, MultibodyPlantConfig

from feasigrasp.errors import ScenarioError
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp.resources import model_path
from feasigrasp.systems.station.cell_check import check_cell
from feasigrasp.systems.station.cell_models import StationConfig, add_cell

ARM = model_path("iiwa", "iiwa7.urdf").read_text
HAND = model_path("iiwa", "gripper.urdf").read_text


def cell(*, arm=None, hand=None, X_WB=None, X_FH=None):
    """Our cell without table and camera; texts of model files and poses may be others."""
    plant = MultibodyPlant(0.002)
    parser = Parser(plant)
    parser.package_map().Add("feasigrasp", str(model_path()))
    folder = str(model_path("iiwa")) + "/"

    def add(text):
        text = text.replace("meshes/", folder + "meshes/").replace('"iiwa7"', '"iiwa"')
        (instance,) = parser.AddModelsFromString(text, "urdf")
        return instance

    iiwa = add(arm or ARM())
    gripper = add(hand or HAND())
    base = plant.GetFrameByName("iiwa_link_0", iiwa)
    plant.WeldFrames(plant.world_frame(), base, X_WB or RigidTransform())
    flange = plant.GetFrameByName("iiwa_flange", iiwa)
    first = plant.get_body(plant.GetBodyIndices(gripper)[0]).body_frame()
    plant.WeldFrames(flange, first, X_FH or RigidTransform())
    plant.Finalize()
    return plant


def test_the_cell_of_the_project_is_accepted():
    plant = MultibodyPlant(0.002)
    parser = Parser(plant)
    parser.package_map().Add("feasigrasp", str(model_path()))
    parser.AddModels(str(model_path("iiwa", "cell.dmd.yaml")))
    plant.Finalize()
    check_cell(plant, ParallelGripper())


def test_the_cell_built_here_is_accepted():
    check_cell(cell(), ParallelGripper())


def test_joints_without_limits_are_accepted():
    plant = cell()
    for name in ("iiwa_joint_1", "iiwa_joint_3"):
        plant.GetJointByName(name).set_position_limits([-float("inf")], [float("inf")])
    check_cell(plant, ParallelGripper())


def longer(text):
    """The URDF of the arm with the fourth joint 3 cm further out."""
    head, tail = text.split('<joint name="iiwa_joint_4"', 1)
    old = '<origin xyz="0 0 0.19" rpy="0 0 0" />'
    assert old in tail
    return head + '<joint name="iiwa_joint_4"' + tail.replace(old, old.replace("0.19", "0.22"), 1)


def mirrored(text):
    """The URDF of the arm with the sixth joint turning the other way."""
    head, tail = text.split('<joint name="iiwa_joint_6"', 1)
    assert '<axis xyz="0 1 0" />' in tail
    tail = tail.replace('<axis xyz="0 1 0" />', '<axis xyz="0 -1 0" />', 1)
    return head + '<joint name="iiwa_joint_6"' + tail


MOVED = RigidTransform([0.05, 0.0, 0.0])
TURNED = RigidTransform(RollPitchYaw(0.0, 0.0, 0.1), [0.0, 0.0, 0.0])
OUT = RigidTransform([0.0, 0.0, 0.05])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"X_WB": MOVED}, ["iiwa_link_0", "50.0 mm", "origin"]),
        ({"X_WB": TURNED}, ["iiwa_link_0", "5.73 degrees"]),
        ({"arm": longer}, ["iiwa_link_4", "30.0 mm"]),
        ({"arm": mirrored}, ["iiwa_link_6", "degrees"]),
        ({"X_FH": OUT}, ["left_finger", "50.0 mm", "iiwa_flange"]),
    ],
)
def test_what_is_off_is_named_with_its_amount(change, words):
    if callable(change.get("arm")):
        change = {"arm": change["arm"](ARM())}
    with pytest.raises(ScenarioError) as error:
        check_cell(cell(**change), ParallelGripper())
    for word in words:
        assert word in str(error.value)


def test_another_hand_is_refused():
    with pytest.raises(ScenarioError, match=r"left_finger|opens"):
        check_cell(cell(), WSG_50)


def test_a_hand_that_opens_less_is_refused():
    with pytest.raises(ScenarioError, match=r"opens 60\.0 mm, 85\.0 are expected"):
        check_cell(cell(hand=HAND().replace('upper="0.0425"', 'upper="0.03"')), ParallelGripper())


def test_a_hand_without_fingers_is_refused():
    tool = '<robot name="gripper"><link name="vacuum"/></robot>'
    with pytest.raises(ScenarioError, match="no left_finger_joint"):
        check_cell(cell(hand=tool), ParallelGripper())


@pytest.mark.parametrize(
    ("attribute", "limits"),
    [("position", (-1.0, 1.0)), ("velocity", (-1.0, 1.0)), ("acceleration", (-1.0, 1.0))],
)
def test_narrower_limits_are_refused(attribute, limits):
    plant = cell()
    joint = plant.GetJointByName("iiwa_joint_3")
    getattr(joint, f"set_{attribute}_limits")([limits[0]], [limits[1]])
    with pytest.raises(ScenarioError, match="iiwa_joint_3"):
        check_cell(plant, ParallelGripper())


def test_a_cell_without_an_arm_is_refused():
    plant = MultibodyPlant(0.002)
    plant.Finalize()
    with pytest.raises(ScenarioError, match="no model named 'iiwa'"):
        check_cell(plant, ParallelGripper())


def test_open_fingers_do_not_touch_their_stops():
    """At rest, a limit that is just reached makes the contact solver give up."""
    plant = MultibodyPlant(0.002)
    directives = LoadModelDirectives(str(model_path("iiwa", "cell.dmd.yaml"))).directives
    add_cell(plant, StationConfig(MultibodyPlantConfig(), directives))
    plant.Finalize()
    hand = plant.GetModelInstanceByName("gripper")
    for name in ("left_finger_joint", "right_finger_joint"):
        joint = plant.GetJointByName(name, hand)
        opening = joint.default_positions()[0]
        assert opening == pytest.approx(ParallelGripper().max_opening / 2, abs=1e-9)
        assert 1e-5 < joint.position_upper_limits()[0] - opening < 1e-4
