"""Fingers are driven no faster than a drive can, and their force deals the arm no blow."""

import numpy as np
import pytest
from pydrake.common.schema import Rotation
from pydrake.systems.analysis import Simulator

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems.station.joints import FingerDrive
from tests.cell import HOME, OPEN, Cell, scenario

PERIOD = 0.0025


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(FingerDrive(PERIOD))
    assert (list(inputs), list(outputs)) == documented_ports(FingerDrive)


@pytest.mark.parametrize(
    ("commanded", "driven_to"),
    [
        (lambda t: 0.08 - 0.15 * t, lambda t: 0.08 - 0.15 * t),  # as fingers close: as it is
        (lambda t: 0.08 if t < 0.05 else -0.02, lambda t: np.clip(0.13 - t, -0.02, 0.08)),
        (lambda t: -0.02 if t < 0.05 else 0.08, lambda t: np.clip(t - 0.07, -0.02, 0.08)),
    ],
)
def test_an_opening_is_followed_at_one_metre_a_second_at_most(commanded, driven_to):
    simulator = Simulator(FingerDrive(PERIOD))
    dut, context = simulator.get_system(), simulator.get_mutable_context()
    for step in range(101):
        t = step * PERIOD
        dut.get_input_port().FixValue(context, [commanded(t)])
        simulator.AdvanceTo(t)
        width = 2.0 * dut.get_output_port().Eval(context)[0]
        assert width == pytest.approx(driven_to(t), abs=2.01 * dut.SPEED * PERIOD)
    assert width == pytest.approx(commanded(t), abs=1e-12)


def test_fingers_that_are_told_to_press_deal_the_arm_no_blow():
    X_WG = forward_kinematics(HOME, ParallelGripper().X_FG)
    config = scenario(model="soup_can")
    # At rest between the pads, 4 mm off the middle: one pad presses before the other.
    config.motion.center = list(X_WG[:3, 3] + 0.004 * X_WG[:3, 0])
    config.motion.amplitude, config.motion.spin = [0.0] * 3, 0.0
    config.object.rotation = Rotation()
    cell = Cell(config).start()
    told_to_press, torques, widths = 0.225, [], []
    for t in PERIOD * np.arange(1, 120):
        opening = OPEN - 0.15 * t if t < told_to_press else -0.05
        cell.fix("gripper.position", [opening])
        cell.advance(t)
        torques.append(cell.read("arm.torque_external"))
        widths.append(cell.read("gripper.state_measured")[0])
    after = round(told_to_press / PERIOD)
    assert max(widths[after:]) < 0.07  # both pads press by then
    # Without the drive it is 1.5 Nm; what is left is the creep of the contact.
    assert np.abs(np.diff(torques[after - 4 :], axis=0)).max() < 0.3
