"""Faults that no sensor tells: leaks of truth, and when an arm comes to rest."""

import numpy as np
import pytest

from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.runs import fault_probe
from feasigrasp_lab.runs.fault_probe import ArmLog, blind_pairs, leaks

FILE = diagram_path("dynamic.scenarios.yaml")


def test_the_runs_of_a_blind_pair_differ_in_what_no_sensor_tells():
    for name, pair in blind_pairs(load_scenario(FILE, "ReachLinearMocap")).items():
        texts = [dump_scenario(parse_scenario(dump_scenario(each))) for each in pair]
        assert texts[0] != texts[1], name


def test_a_leak_is_any_bit_of_the_commands(monkeypatch):
    text = dump_scenario(Scenario())

    def log(scenario):
        commanded = np.zeros((4, 7))
        commanded[2, 3] = next(values)
        return ArmLog(np.arange(4), commanded, commanded, np.zeros(0))

    monkeypatch.setattr(fault_probe, "arm_log", log)
    monkeypatch.setattr(fault_probe, "parse_scenario", lambda text: text)
    values = iter((1.0, 1.0, 1.0, np.nextafter(1.0, 2.0)))
    assert not leaks([text, text])
    assert leaks([text, text])


def test_rest_is_counted_from_the_end_of_the_silence(monkeypatch):
    scenario = load_scenario(FILE, "ReachLinearMocap", "{tracker: {silence: 0.25}}")
    times = np.arange(0.0, 5.0, 0.01)
    measured = np.zeros((500, 7))
    measured[times < 2.6, 5] = -0.3
    measured[times > 2.6, 2] = 0.009
    log = ArmLog(times, measured, measured, np.zeros(0))
    monkeypatch.setattr(fault_probe, "arm_log", lambda _: log)
    for found in fault_probe.rest_times(dump_scenario(scenario), 2.0):
        assert found == pytest.approx(0.34, abs=0.011)
    assert fault_probe.rest_times(dump_scenario(scenario), 4.0) == (0.0, 0.0)


def test_giving_way_to_a_touch_is_counted_from_the_touch():
    """Silent from 1 s on: told to move until 1.3 s, touched from 2 to 3 s, and it gives way."""
    times = np.arange(0.0, 5.0, 0.01)
    commanded, measured = np.zeros((2, 500, 7))
    commanded[times < 1.295, 0] = 0.2
    commanded[(times > 2.045) & (times < 3.195), 3] = 0.2
    measured[times < 3.495, 1] = -0.1
    handled = times[(times > 1.995) & (times < 3.005)]
    rest = fault_probe.rest_of(ArmLog(times, commanded, measured, handled), 1.0)
    assert rest.untouched_s == pytest.approx(0.29, abs=1e-6)
    assert rest.any_s == pytest.approx(2.49, abs=1e-6)
    # The same motion without a touch is none that was called for.
    alone = fault_probe.rest_of(ArmLog(times, commanded, measured, handled[:0]), 1.0)
    assert alone.untouched_s == pytest.approx(2.19, abs=1e-6)


def test_a_touch_and_closed_fingers_are_noted():
    """A run of five steps: nothing, a touch, nothing, a longer touch, fingers that close."""

    class Port:
        def __init__(self, values):
            self.values = values

        def Eval(self, root):
            return self.values[root.step]

    class Part:
        def __init__(self, port, values):
            self.GetOutputPort = {port: Port(values)}.__getitem__

        def GetMyContextFromRoot(self, root):
            return root

    class Root:
        def __init__(self, step):
            self.step = step

        def get_time(self):
            return 0.1 * self.step

    touched = [[0.0, t, 0.0] for t in (0.0, 0.1, 0.1, 0.3, 0.3)]
    parts = {
        "contact": Part("approach", touched),
        "sequencer": Part("phase", [[Phase.APPROACH]] * 4 + [[Phase.CLOSE]]),
    }

    class Cell:
        GetSubsystemByName = parts.__getitem__

    handled = fault_probe.Handled(Cell)
    for step in range(5):
        handled(Root(step))
    assert handled.times == pytest.approx([0.1, 0.3, 0.4])
