"""The robot cell does what its ports say: arm, gripper and object."""

import dataclasses

import numpy as np
import pytest
from pydrake.math import RigidTransform

from feasigrasp.errors import MeshError, ScenarioError
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object, make_motion
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.cell_models import StationConfig
from feasigrasp.systems.station.station import Station
from tests.cell import FILE, HOME, OPEN, Cell, scenario


def test_ports_are_those_of_the_docstring(seeing, ports, documented_ports):
    inputs, outputs = ports(seeing.station)
    documented_inputs, documented_outputs = documented_ports(Station)
    named = [name.replace("<camera>", "wrist_camera") for name in documented_outputs]
    assert list(inputs) == documented_inputs
    late = {f"wrist_camera.{port}" for port in ("pose_now", "position", "gripper_state", "stamp")}
    assert sorted(outputs) == sorted(set(named) - late)
    camera = "{cameras: {wrist_camera: {fps: 30, output_delay: 0.06}}}"
    delayed = make_station(load_scenario(FILE, "ReachLinearMocap", camera))
    assert sorted(ports(delayed)[1]) == sorted(named)
    assert inputs == {"arm.desired_state": 14, "gripper.position": 1, "object.hold": 1}
    sizes = {name: size for name, size in outputs.items() if size is not None}
    assert sizes == {
        "arm.position_measured": 7,
        "arm.velocity_estimated": 7,
        "arm.state_estimated": 14,
        "arm.torque_measured": 7,
        "arm.torque_external": 7,
        "gripper.state_measured": 2,
        "object.let_go": 1,
    }


def test_it_starts_where_the_scenario_says(blind):
    cell = blind.start()
    np.testing.assert_allclose(
        cell.read("arm.state_estimated"), np.r_[cell.scenario.start, np.zeros(7)]
    )
    np.testing.assert_array_equal(
        cell.read("arm.position_measured"), cell.read("arm.state_estimated")[:7]
    )
    np.testing.assert_allclose(cell.read("gripper.state_measured"), [OPEN, 0.0])
    np.testing.assert_allclose(cell.object_pose().GetAsMatrix4(), cell.motion.pose(0.0), atol=1e-12)


def test_the_arm_holds_its_place_against_gravity(blind):
    cell = blind.start()
    cell.advance(0.5)
    np.testing.assert_allclose(cell.read("arm.position_measured"), HOME, atol=1e-4)


def test_the_arm_tracks_a_moving_desired_state(blind):
    cell = blind.start()
    amplitude, rate = 0.1 * np.array([1, -1, 1, -1, 1, -1, 1]), 1.5
    errors = []
    for k in range(200):
        t = 0.005 * k
        q = HOME + amplitude * (1 - np.cos(rate * t))
        cell.fix("arm.desired_state", np.r_[q, amplitude * rate * np.sin(rate * t)])
        errors.append(np.abs(cell.read("arm.position_measured") - q).max())
        cell.advance(t + 0.005)
    # A control period at 0.15 rad/s is 0.75 mrad; inertia x acceleration / kp comes on top.
    assert max(errors) < 0.002


def test_what_a_step_of_the_desired_position_leaves_decays(blind):
    """``Kd de/dt + Kp e = 0``: inertias hardly count beside the damping of a velocity drive."""
    cell = blind.start()
    step, rate = 0.05 * np.array([1, -1, 1, 1, -1, 1, -1]), IIWA_7.kp / IIWA_7.kd
    cell.fix("arm.desired_state", np.r_[HOME + step, np.zeros(7)])
    for t in (1.0, 4.0):
        cell.advance(t)
        left = step * np.exp(-rate * t)
        np.testing.assert_allclose(
            cell.read("arm.position_measured"), HOME + step - left, atol=5e-4
        )
        np.testing.assert_allclose(cell.read("arm.velocity_estimated"), rate * left, atol=5e-4)


@pytest.mark.parametrize("width", [0.01, 0.05, OPEN])
def test_the_gripper_opens_to_the_commanded_width(blind, width):
    cell = blind.start()
    cell.fix("gripper.position", [width])
    cell.advance(0.6)
    measured = cell.read("gripper.state_measured")
    np.testing.assert_allclose(measured, [width, 0.0], atol=5e-4)
    # Either finger is half the width away from the middle, along the closing direction.
    plant = cell.station.plant
    context = plant.GetMyContextFromRoot(cell.context)
    gripper = plant.GetModelInstanceByName("gripper")
    opened = [
        plant.GetJointByName(f"{side}_finger_joint", gripper).get_translation(context)
        for side in ("left", "right")
    ]
    np.testing.assert_allclose(opened, width / 2, atol=5e-4)


def test_the_gripper_closes_until_the_pads_meet(blind):
    cell = blind.start()
    cell.fix("gripper.position", [-0.05])
    cell.advance(0.8)
    assert abs(cell.read("gripper.state_measured")[0]) < 1e-3


def test_the_object_follows_its_motion(blind):
    cell = blind.start()
    for t in np.arange(8, 16) * 0.05:
        cell.advance(round(t, 9))
        X, X_true = cell.object_pose(), RigidTransform(cell.motion.pose(t))
        assert np.linalg.norm(X.translation() - X_true.translation()) < 1e-4
        assert abs((X.rotation().inverse() @ X_true.rotation()).ToAngleAxis().angle()) < 1e-3
        velocity = cell.read("object.velocity").get_coeffs()
        np.testing.assert_allclose(velocity, cell.motion.velocity(t), atol=2e-3)


def test_let_go_the_object_falls(blind):
    cell = blind.start()
    cell.advance(0.3)
    assert cell.read("object.let_go") == np.inf
    cell.fix("object.hold", [0.0])
    let_go = 0.3 + cell.scenario.carrier.release_delay
    cell.advance(let_go)
    assert cell.read("object.let_go") == pytest.approx(let_go, abs=0.003)
    start, speed = cell.object_pose().translation().copy(), cell.motion.velocity(let_go)[3:]
    np.testing.assert_allclose(start, cell.motion.pose(let_go)[:3, 3], atol=1e-4)
    cell.advance(let_go + 0.2)
    moved = cell.object_pose().translation() - start
    np.testing.assert_allclose(moved, 0.2 * speed + [0, 0, -9.81 / 2 * 0.2**2], atol=3e-3)


@pytest.mark.parametrize(("mode", "free"), [("safe", False), ("corrected", True), ("paper", True)])
def test_end_stops_and_torque_limits_are_there_only_in_safe_mode(mode, free):
    cell = Cell(scenario(mode=mode)).start()
    beyond = HOME.copy()
    beyond[0] = IIWA_7.upper[0] + 0.2
    cell.fix("arm.desired_state", np.r_[beyond, np.zeros(7)])
    plant = cell.station.plant
    near = beyond - np.r_[0.3, np.zeros(6)]
    plant.SetPositions(
        plant.GetMyMutableContextFromRoot(cell.context), plant.GetModelInstanceByName("iiwa"), near
    )
    cell.advance(2.0)
    reached = cell.read("arm.position_measured")[0]
    efforts = [plant.GetJointActuatorByName(name).effort_limit() for name in IIWA_7.joint_names]
    np.testing.assert_array_equal(efforts, np.full(7, np.inf) if free else IIWA_7.effort_limits)
    if free:
        left = 0.3 * np.exp(-2.0 * IIWA_7.kp[0] / IIWA_7.kd[0])
        assert IIWA_7.upper[0] + 0.1 < reached
        assert reached == pytest.approx(beyond[0] - left, abs=5e-3)
    else:
        assert reached == pytest.approx(IIWA_7.upper[0], abs=0.02)


def test_a_fresh_context_is_a_fresh_trial(blind):
    runs = []
    for _ in range(2):
        cell = blind.start()
        cell.advance(0.1)
        runs.append(cell.object_pose().GetAsMatrix4())
    np.testing.assert_array_equal(*runs)


def test_a_cell_without_an_arm_is_refused_by_name():
    bare = dataclasses.replace(_config(scenario()), directives=[])
    with pytest.raises(RuntimeError, match="iiwa"):
        Station(bare, load_scenario_object(scenario()), make_motion(scenario()))


def test_an_unknown_object_is_refused_by_name():
    unknown = scenario()
    unknown.object.model = "no_such_thing"
    with pytest.raises(MeshError, match="no_such_thing"):
        make_station(unknown)


def _config(of):
    return StationConfig(plant=of.plant_config, directives=of.directives, q_start=HOME)


def test_a_cell_that_cannot_be_loaded_is_a_clear_error():
    text = "{directives: [{add_directives: {file: package://nowhere/cell.dmd.yaml}}]}"
    broken = load_scenario(FILE, "ReachLinearMocap", text)
    with pytest.raises(ScenarioError, match=r"(?s)cannot be loaded.*cell\.dmd\.yaml"):
        make_station(broken)
