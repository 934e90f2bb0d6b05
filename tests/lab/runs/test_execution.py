"""What stands between the planned and the true hand: an error of its place, and no way at all."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import EventStatus

from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.runs.teleport import teleport
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import make_hand_error
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_station
from feasigrasp_lab.studies.static import PROTOCOLS

FILE = diagram_path("dynamic.scenarios.yaml")
X_FG = ParallelGripper().X_FG


def still(text="{}"):
    return load_scenario(FILE, "Static", "{object: {model: ball}}", text)


def hand_poses(station):
    """True poses of fingers (closed) and camera in the world, by Drake."""
    plant = station.plant
    context = plant.CreateDefaultContext()
    hand = plant.GetModelInstanceByName("gripper")
    joint = plant.GetJointByName("left_finger_joint", hand)
    joint.set_translation(context, 0.0)
    frames = joint.child_body().body_frame(), plant.GetFrameByName("camera_optical")
    return [frame.CalcPoseInWorld(context).GetAsMatrix4() for frame in frames]


def test_the_true_hand_is_off_by_what_was_drawn_and_the_camera_is_not():
    text = "{execution: {position_error: 0.005, angle_error: 0.0873}, random_seed: 4}"
    off, nominal = still(text), still("{random_seed: 4}")
    (finger, camera), (expected, where) = map(hand_poses, map(make_station, (off, nominal)))
    error = se3.inverse(expected) @ finger
    np.testing.assert_allclose(error, make_hand_error(off), atol=1e-9)
    assert np.linalg.norm(error[:3, 3]) == pytest.approx(0.005)
    assert se3.rotation_angle(error[:3, :3]) == pytest.approx(0.0873)
    np.testing.assert_allclose(camera, where, atol=1e-12)
    make_dynamic_grasp(off)  # its own check of the cell expects that error


def test_the_direction_of_the_error_is_drawn_from_the_seed():
    errors = [
        make_hand_error(still(f"{{execution: {{position_error: 1.0e-2}}, random_seed: {seed}}}"))
        for seed in (0, 0, 1)
    ]
    np.testing.assert_array_equal(errors[0], errors[1])
    assert np.linalg.norm(errors[0] - errors[2]) > 1e-3
    assert np.linalg.norm(errors[2][:3, 3]) == pytest.approx(0.01)


def test_the_arm_is_at_a_grasp_at_once():
    scenario = still("{random_seed: 1}")
    PROTOCOLS["paper"](scenario)
    diagram = make_dynamic_grasp(scenario)
    simulator = Simulator(diagram)
    simulator.Initialize()
    teleport(simulator, Reachability(), 2.0)
    root = simulator.get_context()
    assert 0.0 < root.get_time() < 1.0

    def output(system, port):
        found = diagram.GetSubsystemByName(system)
        return found.GetOutputPort(port).Eval(found.GetMyContextFromRoot(root))

    q, rest = np.split(output("drive", "desired_state"), 2)
    np.testing.assert_array_equal(rest, 0.0)
    assert np.abs(q - scenario.start).max() > 0.05
    X_WG = forward_kinematics(q, X_FG)
    X_WO = output("sequencer", "object_pose").GetAsMatrix4()
    at = np.linalg.norm(X_WO @ output("sequencer", "grasps").X_OG - X_WG, axis=(1, 2))
    assert at.min() < 1e-6
    # The encoders say so, rounded; the joints are off by their zeros.
    measured, true = (
        output("station", f"arm.{name}")[:7] for name in ("position_measured", "state_estimated")
    )
    joints = scenario.sensors.joints
    np.testing.assert_allclose(measured, q, atol=np.deg2rad(0.5 * joints.encoder_step_deg) + 1e-9)
    assert 0.0 < np.abs(true - q).max() < np.deg2rad(4.0 * joints.encoder_zero_deg)


def test_without_a_grasp_the_arm_stays():
    scenario = still("{motion: {center: [1.5, 0.0, 0.6]}}")
    simulator = Simulator(make_dynamic_grasp(scenario))
    simulator.Initialize()
    teleport(simulator, Reachability(), 0.11)
    assert simulator.get_context().get_time() == pytest.approx(0.11)


def test_a_monitor_ends_a_run_that_waits_for_grasps():
    simulator = Simulator(make_dynamic_grasp(still("{motion: {center: [1.5, 0.0, 0.6]}}")))
    simulator.Initialize()
    simulator.set_monitor(
        lambda root: (
            EventStatus.ReachedTermination(simulator.get_system(), "enough")
            if root.get_time() > 0.02
            else EventStatus.DidNothing()
        )
    )
    assert not teleport(simulator, Reachability(), 0.5)
    assert simulator.get_context().get_time() < 0.1
