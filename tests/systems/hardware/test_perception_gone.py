"""Over the wire: perception's process is killed while the arm is on its way."""

import os
import signal
import time

import numpy as np
import pytest
from pydrake.lcm import DrakeLcm
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.status import StatusCode
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.control_loop import ControlLoop
from feasigrasp.systems.hardware.guard import Guard
from feasigrasp.systems.hardware.simulated_cell import make_simulated_cell
from feasigrasp.systems.remote.remote_stage import end_processes

#: So long the loop is given to do something [wall s].
PATIENCE = 200.0


class Bench:
    """Cell, guard and controller on one bus; time goes on where `step` is called."""

    def __init__(self):
        text = "{grasp: {close: false}}"
        scenario = load_scenario(
            diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap", None, text
        )
        lcm = DrakeLcm("memq://")
        self.cell = Simulator(make_simulated_cell(scenario, lcm))
        self.loop, self.ticks = ControlLoop(scenario, lcm), 0
        self.guard = Guard(lcm, clock=lambda: self.ticks * channels.IIWA_PERIOD)
        self.perception = self.loop.diagram.GetSubsystemByName("perception")
        self.cell.Initialize()

    def step(self):
        self.ticks += 1
        self.cell.AdvanceTo(self.ticks * channels.IIWA_PERIOD)
        self.loop.step(0.0)

    def until(self, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline
            self.step()

    def code(self):
        monitor = self.loop.diagram.GetSubsystemByName("status")
        history = monitor.history(monitor.GetMyContextFromRoot(self.loop.simulator.get_context()))
        return history[-1].code if history else None

    def speed(self):
        """Of the fastest joint, as the simulation has it [rad/s]."""
        station = self.cell.get_system().GetSubsystemByName("station")
        context = station.GetMyContextFromRoot(self.cell.get_context())
        return np.abs(station.GetOutputPort("arm.state_estimated").Eval(context)[7:]).max()


@pytest.fixture
def bench():
    made = Bench()
    yield made
    end_processes(made.loop.diagram)


def test_the_arm_rests_it_is_said_and_another_process_takes_over(bench):
    bench.until(lambda: bench.loop.image_to_grasps and bench.speed() > 0.1)
    worker = bench.perception.worker
    pid, moved = worker.pid, bench.speed()
    os.kill(pid, signal.SIGKILL)
    bench.until(lambda: bench.code() is StatusCode.PERCEPTION_LAPSED)
    lapsed = bench.ticks
    bench.until(lambda: bench.speed() < 0.1 * moved)
    assert bench.ticks - lapsed < 80  # 0.4 s, in which no process starts
    assert not worker.ready.is_set()
    bench.until(lambda: bench.code() is StatusCode.FOLLOWING)
    assert worker.pid != pid
    bench.until(lambda: bench.speed() > 0.05)
