"""The arm's speed: a share of its velocity limits that nothing exceeds."""

import argparse

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.commands import guard, run, sim
from feasigrasp.models.grasps.sequence import GraspSequenceConfig, GraspState, Phase
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from tests.pipeline import scenario
from tests.rollout import roll_out

V = IIWA_7.velocity_limits


@pytest.mark.parametrize("controller", ["task", "joint", "nearest"])
@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_no_tick_of_a_run_is_faster(controller, speed):
    """Grasps all over the object, an ideal arm: what is sent is what the arm does."""
    text = f"{{control: {{controller: {controller}, speed: {speed}}}}}"
    states = roll_out(scenario("ReachCircularMocap", text), duration=4.0).states
    share = np.abs(states[:, 7:]) / V
    assert share.max() <= speed + 1e-12
    assert share.max() > 0.5 * speed  # it is made use of
    # Accelerations keep their own limits: a slow arm may brake as hard as a quick one.
    change = np.abs(np.diff(states[:, 7:], axis=0)) / 0.005
    assert np.all(change <= IIWA_7.acceleration_limits * (1.0 + 1e-9))


@pytest.mark.parametrize("controller", ["task", "joint"])
def test_the_arm_of_the_whole_pipeline_is_no_faster(controller):
    """With camera and physics, on the way to an object; what it truly does, and what it is sent."""
    text = f"{{control: {{controller: {controller}, speed: 0.2}}}}"
    diagram = make_dynamic_grasp(scenario("ReachLinearMocap", text))
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.0)
    for name in ("drive", "arm"):
        log = diagram.GetSubsystemByName(f"log({name})").FindLog(simulator.get_context())
        share = np.abs(log.data()[7:]) / V[:, None]
        assert 0.15 < share.max() <= 0.2 + 1e-12, name


def test_lift_and_shake_ask_for_the_same_share():
    """The hand goes the same way, and nowhere faster than a share of what it did."""
    full, slow = GraspSequenceConfig(), GraspSequenceConfig().at_speed(0.25)
    still = np.eye(4), np.zeros(6)
    for phase, lasts in ((Phase.LIFT, full.lift_time), (Phase.SHAKE, full.shake_time)):
        state = GraspState(phase=phase, X_WO=np.eye(4), V_WO=np.zeros(6))
        for t in np.linspace(0.0, lasts, 50):
            X, V_H = state.target(t, *still, full)
            X_slow, V_slow = state.target(t / 0.25, *still, slow)
            np.testing.assert_allclose(X_slow, X, atol=1e-9)
            np.testing.assert_allclose(V_slow, 0.25 * V_H, atol=1e-9)
    assert full.at_speed(1.0) == full
    assert slow.closing_speed == full.closing_speed and slow.hold_time == full.hold_time


def arguments(command, *words):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([*words])


@pytest.mark.parametrize(("text", "speed"), [("20%", 0.2), ("0.2", 0.2), ("100%", 1.0)])
def test_the_option_is_a_percentage_or_a_share(text, speed):
    for command in (run, sim):
        args = arguments(command, "ReachLinearMocap", "--speed", text)
        assert run.load(args)[1].control.speed == pytest.approx(speed)
        assert run.load(args, on_hardware=True)[1].control.speed == pytest.approx(speed)
    assert arguments(guard, "--speed", text).speed == pytest.approx(speed)


@pytest.mark.parametrize("text", ["20", "0", "-5%", "101%", "nan", "fast"])
def test_what_is_no_share_is_refused(text, capsys):
    with pytest.raises(SystemExit):
        arguments(run, "ReachLinearMocap", f"--speed={text}")
    assert "--speed" in capsys.readouterr().err


def test_hardware_is_slow_until_it_is_told_otherwise(tmp_path):
    args = arguments(run, "ReachLinearMocap")
    assert run.load(args)[1].control.speed == 1.0
    slow = run.load(args, on_hardware=True)[1]
    assert slow.control.speed == run.HARDWARE_SPEED == 0.25
    assert "25%" in run.speed_text(slow.control.speed, on_hardware=True)
    told = arguments(run, "ReachLinearMocap", "--scenario-text", "{control: {speed: 0.6}}")
    assert run.load(told, on_hardware=True)[1].control.speed == 0.6
    (tmp_path / "own.yaml").write_text(
        "Own: {cameras: {wrist_camera: {depth: true}}, control: {speed: 0.7}}"
    )
    (tmp_path / "based.yaml").write_text("Own: {based_on: ReachLinear}")
    based = arguments(run, "Own", "--scenario-file", str(tmp_path / "based.yaml"))
    assert run.load(based, on_hardware=True)[1].control.speed == run.HARDWARE_SPEED
    own = arguments(run, "Own", "--scenario-file", str(tmp_path / "own.yaml"))
    assert run.load(own, on_hardware=True)[1].control.speed == 0.7
    assert run.speed_text(1.0, on_hardware=False) == ""
    assert "100%" in run.speed_text(1.0, on_hardware=True)
