"""``feasigrasp bench soak``: what it measures of every part of a run."""

from resource import RUSAGE_SELF, getrusage

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import dump_scenario, load_scenario
from feasigrasp_lab.bench import soak

FILE = diagram_path("dynamic.scenarios.yaml")
#: All logs of the diagram.
LOGS = ("log(metrics)", "log(obstacle_distance)", "log(drive)", "log(arm)", "log(torque)")


def test_growth_compares_the_end_with_what_comes_after_the_first_part():
    parts = [{"memory_mib": 50.0, "tick_p99_us": 900.0}]
    parts += [{"memory_mib": 100.0, "tick_p99_us": 200.0}] * 16
    parts += [{"memory_mib": 103.0, "tick_p99_us": 230.0}] * 3
    memory, tick = soak.growth_rows("task", parts)
    assert (memory.name, tick.name) == (
        "faults.soak_memory_growth_percent",
        "faults.soak_tick_p99_growth_percent",
    )
    assert memory.value == pytest.approx(3.0) and tick.value == pytest.approx(15.0)


def test_a_soak_measures_every_part_and_drops_its_logs(monkeypatch):
    class Watched(Simulator):
        def __init__(self, diagram):
            super().__init__(diagram)
            made.append((diagram, self))

    made = []
    monkeypatch.setattr(soak, "Simulator", Watched)
    few = "{n_candidates: 50, n_grasps: 8, sampler: antipodal, max_points: 120}"
    text = f"{{object: {{model: ball}}, perception: {few}, simulation_duration: 0.4}}"
    scenario = load_scenario(FILE, soak.SCENARIO, text)
    parts = soak.soak("task", dump_scenario(scenario))
    assert [part["until_s"] for part in parts] == pytest.approx(0.02 * np.arange(1, 21))
    ((diagram, simulator),) = made
    logs = [diagram.GetSubsystemByName(name) for name in LOGS]
    assert [log.FindLog(simulator.get_context()).num_samples() for log in logs] == [0] * len(LOGS)
    for part in parts:
        # This very process, whatever ran in it before: never more than its largest size [KiB].
        assert 50.0 < part["memory_mib"] <= getrusage(RUSAGE_SELF).ru_maxrss / 1024.0 + 1.0
        assert 0.0 < part["tick_p50_us"] <= part["tick_p99_us"] < 1e6
