"""Whoever carries the object lets it go once fingers have squeezed it for a while."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.models.grasps.sequence import GraspSequenceConfig, Phase
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.systems.hardware.simulated_cell import Handover

CONFIG, GRIPPER = GraspSequenceConfig(), ParallelGripper()
WIDTH = 0.05
#: Fingers that close so fast stop at the object at that time [m/s, s].
SPEED = 0.15
STOPPED = (GRIPPER.max_opening - WIDTH) / SPEED


def simulated(told_to_squeeze, width=WIDTH):
    """Times, phases and whether it is held, of fingers that close from the start on."""
    simulator = Simulator(Handover(CONFIG, GRIPPER))
    dut, context = simulator.get_system(), simulator.get_mutable_context()
    rows = []
    for t in np.arange(0.0, 1.5, Handover.PERIOD):
        told = GRIPPER.max_opening - SPEED * t if t < told_to_squeeze else 0.0
        measured = max(GRIPPER.max_opening - SPEED * t, width)
        dut.GetInputPort("target").FixValue(context, [max(told, 0.0)])
        rate = -SPEED if measured > width else 0.0
        dut.GetInputPort("gripper_state").FixValue(context, [measured, rate])
        simulator.AdvanceTo(t)
        rows.append([t, *(dut.GetOutputPort(n).Eval(context)[0] for n in ("phase", "object_hold"))])
    return np.array(rows)


@pytest.mark.parametrize("late", [0.0, 0.15])
def test_it_is_let_go_once_it_was_squeezed_for_so_long(late):
    """And not once fingers have stopped, which squeeze only when they are told to."""
    told = STOPPED + late
    t, phase, held = simulated(told).T
    let_go = t[np.argmin(held)]
    # Fingers that have not been told for 0.2 s may not have begun to move.
    assert let_go == pytest.approx(max(told, 0.2) + CONFIG.squeeze_time, abs=0.031)
    assert set(phase[t < let_go - 0.02]) <= {Phase.APPROACH, Phase.CLOSE}
    assert phase[-1] == Phase.LIFT


def test_fingers_that_meet_do_not_hold_it():
    t, _, held = simulated(0.7, width=0.0).T
    assert held.all()
