"""Watching a run: the live view's controls, and the translucent arm of another mode."""

import threading
import time

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.primitives import ConstantVectorSource

from feasigrasp import cli
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.runs import ghost as ghost_module
from feasigrasp.runs.ghost import ghost_of, show_ghost
from feasigrasp.runs.live import FASTEST, PAUSE, SPEED, LiveView
from feasigrasp.runs.replay import quiet_meshcat
from feasigrasp.scenario import load_scenario
from feasigrasp.scenario.files import dump_scenario

FILE = diagram_path("dynamic.scenarios.yaml")


def packed(text):
    """A short word in MessagePack."""
    return bytes([0xA0 + len(text)]) + text.encode()


def press(live):
    """What the page sends when its button is pressed."""
    entries = packed("type") + packed("button") + packed("name") + packed(PAUSE)
    live.meshcat._InjectWebsocketMessage(message=b"\x82" + entries)


@pytest.fixture
def live():
    return LiveView(quiet_meshcat())


@pytest.fixture
def simulator():
    return Simulator(ConstantVectorSource([0.0]))


def test_it_runs_as_fast_as_the_slider_says(live, simulator):
    never = threading.Event()
    rates = []
    for speed in (1.0, 0.5, FASTEST):
        live.meshcat.SetSliderValue(SPEED, speed)
        live.pace(simulator, never)
        rates.append(simulator.get_target_realtime_rate())
    assert rates == [1.0, 0.5, 0.0]  # the last: as fast as it goes


def test_it_keeps_real_time_and_catches_up_no_pause(live, simulator, monkeypatch):
    """What runs meanwhile takes at least the time that it simulates, after a pause too."""
    never = threading.Event()
    simulator.set_monitor(lambda context: live.pace(simulator, never))
    live.pace(simulator, never)
    press(live)
    assert live.paused
    sleep = time.sleep

    def wait(seconds):  # Meshcat takes messages of its own thread only
        sleep(0.4)
        press(live)

    monkeypatch.setattr(time, "sleep", wait)
    live.pace(simulator, never)  # waits for the second press
    assert not live.paused
    monkeypatch.undo()
    began = time.perf_counter()
    for until in np.arange(0.05, 0.31, 0.05):
        simulator.AdvanceTo(until)  # waits before its step, not behind it
    assert time.perf_counter() - began > 0.2


def test_a_pause_ends_with_an_interrupt(live, simulator):
    interrupted = threading.Event()
    press(live)
    threading.Timer(0.1, interrupted.set).start()
    live.pace(simulator, interrupted)
    assert live.paused and interrupted.is_set()


def test_the_ghost_goes_the_way_of_its_mode():
    """From the start of the scenario, on a way that is not that of safe mode."""
    text, ways = "{perception: {period: 0.25, latency: 0.0}}", []
    for mode in ("safe", "corrected"):
        scenario = load_scenario(FILE, "ReachLinearMocap", text, f"{{control: {{mode: {mode}}}}}")
        times, q = ghost_of(scenario, 1.0)
        ways.append(q)
        np.testing.assert_allclose(q[0], scenario.start, atol=1e-9)
        assert times[0] == 0.0 and times[-1] == pytest.approx(1.0)
    assert np.abs(ways[0][-1] - ways[1][-1]).max() > 0.02


def test_the_ghost_is_drawn_where_it_was():
    """Its links have the transforms of its joint angles in the recording, and stand alone."""
    scenario = load_scenario(FILE, "ReachLinearMocap")
    q = np.linspace(0.0, 0.5, 7)
    meshcat = quiet_meshcat()
    show_ghost(meshcat, scenario, np.array([0.0, 0.1]), np.array([q, q]), 20.0)
    flange = f"{ghost_module.PREFIX}/iiwa/iiwa_link_7"
    assert meshcat.HasPath(flange)
    assert not meshcat.HasPath(f"{ghost_module.PREFIX}/table")
    X_7F = np.eye(4)
    X_7F[2, 3] = IIWA_7.link_steps[-1]
    expected = forward_kinematics(q, np.linalg.inv(X_7F))
    np.testing.assert_allclose(_transform(meshcat, flange), expected, atol=1e-6)


def _transform(meshcat, path):
    """The transform of a path, as the page would get it: sixteen doubles, column by column."""
    packed = meshcat._GetPackedTransform(path)
    numbers = packed[packed.index(b"matrix") + len(b"matrix\xdc\x00\x10") :]
    doubles = [numbers[9 * k + 1 : 9 * k + 9] for k in range(16)]  # each behind its type
    return np.frombuffer(b"".join(doubles), dtype=">f8").reshape(4, 4).T


def test_a_ghost_without_a_replay_is_refused(capsys):
    assert cli.main(["run", "ReachLinearMocap", "--ghost", "paper"]) == 2
    assert "give --replay FILE.html as well" in capsys.readouterr().err


@pytest.mark.parametrize(("options", "mode"), [([], "paper"), (["--mode", "paper"], "corrected")])
def test_a_ghost_is_the_same_scenario_with_the_defaults_of_its_mode(
    options, mode, tmp_path, monkeypatch
):
    class Called(Exception):
        """Nothing is simulated."""

    def run(scenario, name, *, ghost, **_):
        expected = load_scenario(FILE, name, f"{{control: {{mode: {mode}}}}}")
        assert dump_scenario(ghost) == dump_scenario(expected)
        raise Called

    monkeypatch.setattr("feasigrasp.commands.run.run", run)
    monkeypatch.setattr("feasigrasp.commands.run.is_warm", lambda groups: True)
    argv = ["run", "ReachLinearMocap", "--ghost", mode, "--replay", str(tmp_path / "a.html")]
    with pytest.raises(Called):
        cli.main([*argv, *options])


@pytest.mark.parametrize("option", [["--speed", "20%"], ["--arm", "panda"]])
def test_a_ghost_that_its_mode_refuses_costs_no_simulation(option, tmp_path, monkeypatch, capsys):
    monkeypatch.delattr("feasigrasp.commands.run.run")
    argv = ["run", "ReachLinearMocap", "--ghost", "paper", "--replay", str(tmp_path / "a.html")]
    assert cli.main([*argv, *option]) == 2
    assert "control" in capsys.readouterr().err.splitlines()[-1]
