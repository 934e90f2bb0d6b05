"""The log of a run against what happened: the arm's state, the object's path, the controller."""

import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.analysis import Simulator

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.monitoring.run_log import RunLog, add_run_log, fields, read_run_log
from tests.pipeline import scenario

PAGE = Path(__file__).parents[3] / "docs/results_schema.md"


@pytest.fixture(scope="module")
def logged():
    """A diagram with the object's pose given, its simulator after 1.2 s, and its log."""
    diagram = make_dynamic_grasp(scenario(), connect=add_run_log)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.2)
    return diagram, simulator, read_run_log(diagram, simulator.get_context())


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    given, outputs = ports(RunLog())
    assert (list(given), list(outputs)) == documented_ports(RunLog)


def test_the_documentation_defines_every_array():
    section = PAGE.read_text().partition("## Log of one run")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in section.splitlines() if line.startswith("| `")]
    shapes = {}
    for _, names, shape, *_ in rows:
        shapes |= dict.fromkeys(re.findall(r"`(\w+)`", names), shape.strip())
    shown = {name: f"(n, {', '.join(map(str, shape))})" for name, shape in fields(7).items()}
    assert shapes == {"time": "(n,)"} | {
        name: "(n,)" if shape == "(n, 1)" else shape for name, shape in shown.items()
    }


def test_it_has_a_sample_for_every_tick_of_the_control(logged):
    log = logged[2]
    np.testing.assert_allclose(log["time"], np.arange(241) * 0.005, atol=1e-9)
    assert {name: array.shape for name, array in log.items() if name != "time"} == {
        name: (241, *(() if shape == (1,) else shape)) for name, shape in fields(7).items()
    }
    assert not [name for name, array in log.items() if array.dtype.hasobject]


def test_joints_and_commands_are_those_of_arm_and_drive(logged):
    diagram, simulator, log = logged
    arm, drive = (
        diagram.GetSubsystemByName(f"log({name})").FindLog(simulator.get_context()).data().T
        for name in ("arm", "drive")
    )
    np.testing.assert_array_equal(log["qd"], arm[:, 7:])
    # Encoders have zeros that stay, and round.
    joints, off = scenario().sensors.joints, log["q"] - arm[:, :7]
    step, zero = np.deg2rad(joints.encoder_step_deg), np.deg2rad(joints.encoder_zero_deg)
    np.testing.assert_allclose(log["q"] / step, np.rint(log["q"] / step), atol=1e-6)
    assert (np.ptp(off, axis=0) < 1.001 * step).all()
    assert step < np.abs(off.mean(axis=0)).max() < 4.0 * zero
    np.testing.assert_array_equal(np.hstack([log["q_sent"], log["qd_sent"]]), drive)
    # The drive sends what was commanded a tick before, but where the controller plans anew.
    sent, commanded = log["qd_sent"][1:], log["qd_commanded"][:-1]
    planned = np.arange(len(sent)) % 4 == 0
    np.testing.assert_allclose(sent[~planned], commanded[~planned], atol=1e-6)
    assert np.abs(log["qd_commanded"]).max() > 0.2
    assert (np.abs(log["qd_sent"]) <= IIWA_7.velocity_limits + 1e-9).all()


def test_poses_are_those_of_the_objects_path(logged):
    log = logged[2]
    motion = make_motion(scenario())
    path = np.array([motion.pose(t) for t in log["time"]])
    # It starts at rest, and is carried by a spring.
    np.testing.assert_allclose(log["X_WO_true"][100:], path[100:], atol=3e-3)
    np.testing.assert_allclose(log["X_WO"][100:], log["X_WO_true"][100:], atol=0.02)
    assert np.ptp(log["X_WO_true"][:, 1, 3]) > 0.05


def test_the_chosen_grasp_is_where_the_hand_goes(logged):
    log = logged[2]
    assert np.isnan(log["X_OG"][0]).all()  # nothing was seen yet
    chosen = np.isfinite(log["X_OG"][:, 0, 0])
    assert chosen[-1] and (log["phase"] == Phase.APPROACH).all()
    np.testing.assert_array_equal(chosen, np.isfinite(log["X_OG"]).all(axis=(1, 2)))
    X_WH = forward_kinematics(log["q"][chosen], ParallelGripper().X_FG)
    X_WG = log["X_WO"][chosen] @ log["X_OG"][chosen]
    left = np.linalg.norm(X_WH[:, :3, 3] - X_WG[:, :3, 3], axis=1)
    assert left[-1] < 0.5 * left[0]
    R = log["X_OG"][chosen][:, :3, :3]
    np.testing.assert_allclose(R @ R.swapaxes(1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-9)


@pytest.mark.parametrize("phase", [Phase.APPROACH, Phase.CLOSE])
def test_from_closing_on_it_is_the_grasp_committed_to(fixed_context, phase):
    """Whatever the controller goes for; and a cell without truth, on hardware, has no true pose."""
    committed, other = (se3.make_pose(np.eye(3), [0.0, 0.0, z]) for z in (0.1, 0.2))
    zeros = {"position": 7, "velocity": 7, "commanded_velocity": 7, "desired_state": 14}
    zeros |= {"gripper_state": 2, "gripper_position": 1}
    dut = RunLog()
    context = fixed_context(
        dut,
        **{name: np.zeros(size) for name, size in zeros.items()},
        object_pose=RigidTransform(),
        phase=[float(phase)],
        grasps=GraspSet(committed[None], np.zeros(1), np.ones(1)),
        chosen_grasp=other.ravel(),
    )
    sample = dut.get_output_port().Eval(context)
    expected = other if phase == Phase.APPROACH else committed
    np.testing.assert_array_equal(sample[-16:].reshape(4, 4), expected)
    true_pose = 7 * 5 + 2 + 16
    assert np.isnan(sample[true_pose : true_pose + 16]).all()


@pytest.mark.parametrize("law", ["joint", "nearest"])
def test_other_controllers_are_logged_too(law):
    """Each with the grasp that it goes for."""
    text = f"{{control: {{controller: {law}}}}}"
    diagram = make_dynamic_grasp(scenario(text=text), connect=add_run_log)
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.8)
    log = read_run_log(diagram, simulator.get_context())
    assert np.abs(log["qd_commanded"]).max() > 0.1
    assert np.isfinite(log["X_OG"][-1]).all()
