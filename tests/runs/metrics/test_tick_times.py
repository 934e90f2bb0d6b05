"""Tick times of a controller that takes a known time."""

import time

import numpy as np
import pytest

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.runs.metrics.tick_times import TickTimes
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp_lab.bench.control import ControllerProbe
from feasigrasp_lab.paper.modes import Unenforced


class Slow(Unenforced, GraspController):
    """Takes 30 ms to plan, 5 ms for a command and 50 ms for the first one."""

    def update(self, memory, inputs):
        time.sleep(0.03)
        return 1

    def velocity(self, memory, inputs):
        self.commands = getattr(self, "commands", 0) + 1
        time.sleep(0.05 if self.commands == 1 else 0.005)
        return np.zeros(7)


def test_every_command_and_every_plan_is_timed():
    controller = Slow(Reachability())
    times = TickTimes(controller)
    assert set(times.metrics().values()) == {None}
    probe = ControllerProbe(controller, GraspSet.empty(), np.random.default_rng(0))
    for _ in range(20):
        np.testing.assert_array_equal(probe.step(), np.zeros(7))
    found = times.metrics()
    # The first one counts; a busy machine can only make it more.
    assert controller.commands == 20
    assert found["control_ms_worst"] >= 50.0 > 5.0 <= found["control_ms_p99"]
    assert found["control_ms_p99"] < found["control_ms_worst"]
    assert found["planning_ms_median"] >= 30.0
    assert found["planning_ms_median"] <= found["planning_ms_p99"] <= found["planning_ms_worst"]


def test_a_tick_that_waits_takes_no_processor_time():
    controller = Slow(Reachability())
    times = TickTimes(controller)
    controller.update(None, None)
    found = times.metrics()
    assert found["planning_cpu_ms_worst"] < 15.0 < 30.0 <= found["planning_ms_worst"]


def test_another_controller_is_left_alone():
    watched, other = Slow(Reachability()), Slow(Reachability())
    times = TickTimes(watched)
    other.update(None, None)
    assert times.metrics()["planning_ms_worst"] is None
    with pytest.raises(TypeError):
        watched.update()  # what it raises is raised, and timed
    assert times.metrics()["planning_ms_worst"] is not None
