"""Distances of the arm to its surroundings, against ones measured by hand."""

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.object_contact import ObstacleDistance

HOME = np.deg2rad([0.0, -48.5, 0.0, -90.6, 0.0, 82.9, 0.0])
#: Upright: the arm is a column, only its base and first links are near anything.
UPRIGHT = np.zeros(7)
WALL_Y, WALL_HALF = 0.28, 0.01


class Cell:
    """A station and the distance that is measured in it."""

    def __init__(self, name, text=""):
        scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), name, text)
        scenario.cameras = {}
        self.station = make_station(scenario)
        self.dut = ObstacleDistance(self.station.plant, self.station.robot_instances())

    def measure(self, q, p_WO=(5.0, 5.0, 5.0)):
        station = self.station
        root = station.CreateDefaultContext()
        plant_context = station.plant.GetMyMutableContextFromRoot(root)
        station.plant.SetPositions(plant_context, station.plant.GetModelInstanceByName("iiwa"), q)
        station.plant.SetFreeBodyPose(
            plant_context, station.object_body, RigidTransform(np.array(p_WO))
        )
        # A query that stays valid: the port of the scene graph, evaluated in this context.
        query = station.GetOutputPort("query_object").Eval(root)
        context = self.dut.CreateDefaultContext()
        self.dut.GetInputPort("query_object").FixValue(context, query)
        return self.dut.get_output_port().Eval(context)[0]


@pytest.fixture(scope="module")
def table():
    return Cell("ReachLinearMocap")


@pytest.fixture(scope="module")
def wall():
    return Cell("ReachObstacleMocap")


def test_ports_are_those_of_the_docstring(table, ports, documented_ports):
    inputs, outputs = ports(table.dut)
    assert (list(inputs), list(outputs)) == documented_ports(ObstacleDistance)


def test_the_object_is_no_obstacle(table):
    hand = forward_kinematics(HOME, ParallelGripper().X_FG)[:3, 3]
    assert table.measure(HOME, hand) == pytest.approx(table.measure(HOME))
    assert table.measure(HOME) > 0.05


def test_a_hand_over_the_table_is_as_far_as_its_height(table):
    """Lowered with the flange pointing straight down, the distance falls by as much as the hand."""
    heights, distances = [], []
    for bend in (70.0, 75.0, 80.0):
        # Upper arm and forearm fold forward; the wrist keeps the fingers vertical.
        q = np.deg2rad([0.0, 55.0, 0.0, -bend, 0.0, 180.0 - 55.0 - bend, 0.0])
        X_WH = forward_kinematics(q, ParallelGripper().X_FG)
        np.testing.assert_allclose(X_WH[:3, 2], [0.0, 0.0, -1.0], atol=1e-9)
        heights.append(X_WH[2, 3])
        distances.append(table.measure(q))
    assert np.ptp(heights) > 0.01
    np.testing.assert_allclose(np.diff(distances), np.diff(heights), atol=1e-6)
    # The pads reach a little beyond the contact centre.
    assert 0.0 < heights[0] - distances[0] < 0.03


def test_the_wall_is_an_obstacle_and_the_arm_can_go_through_it(wall):
    q = np.deg2rad([0.0, 30.0, 0.0, -60.0, 0.0, 90.0, 0.0])
    hand = forward_kinematics(q, ParallelGripper().X_FG)[:3, 3]
    reach, height = np.hypot(*hand[:2]), hand[2]
    assert 0.3 < reach < 0.8 and height < 0.8  # where the wall stands
    before = wall.measure(q)
    assert 0.0 < before < WALL_Y - WALL_HALF
    q[0] = np.arcsin(WALL_Y / reach)  # the hand's middle in the wall's middle
    assert wall.measure(q) < -0.5 * WALL_HALF


def test_without_surroundings_it_is_infinite():
    cell = Cell("ReachLinearMocap", "{directives: [{add_model: {name: iiwa, file: "
                "package://feasigrasp/iiwa/iiwa7.urdf}}, {add_weld: {parent: world, child: "
                "iiwa::iiwa_link_0}}, {add_model: {name: gripper, file: "
                "package://feasigrasp/iiwa/gripper.urdf}}, {add_weld: {parent: iiwa::iiwa_flange, "
                "child: gripper::gripper_body}}]}")  # fmt: skip
    assert cell.measure(UPRIGHT) == np.inf
