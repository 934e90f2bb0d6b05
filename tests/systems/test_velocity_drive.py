"""The drive integrates commands inside every limit and never passes on what is not finite."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.systems.velocity_drive import VelocityDrive

#: Accelerations that are sent at most [rad/s^2].
SENT = IIWA_7.acceleration_share * IIWA_7.acceleration_limits
PERIOD = 0.005
Q0 = np.deg2rad([0.0, -48.5, 10.0, -90.6, 0.0, 82.9, 20.0])


def fixed(q=Q0, velocity=0.0, **kwargs):
    """A drive, the simulator that runs it, and its context with fixed inputs."""
    dut = VelocityDrive(PERIOD, **kwargs)
    simulator = Simulator(dut)
    context = simulator.get_mutable_context()
    dut.GetInputPort("position").FixValue(context, q)
    dut.GetInputPort("velocity").FixValue(context, np.full(7, velocity))
    return dut, simulator, context


def drive(command, ticks, *, q=Q0, follow=True, **kwargs):
    """Desired states after each tick, shape (ticks, 14); the arm follows exactly or not at all."""
    dut, simulator, context = fixed(q, **kwargs)
    simulator.Initialize()
    states = []
    for k in range(ticks):
        now = command(k) if callable(command) else command
        dut.GetInputPort("velocity").FixValue(context, now)
        simulator.AdvanceTo((k + 0.5) * PERIOD)  # past the update at k * PERIOD
        states.append(dut.GetOutputPort("desired_state").Eval(context).copy())
        if follow:
            dut.GetInputPort("position").FixValue(context, states[-1][:7])
    return np.array(states)


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(VelocityDrive(PERIOD))
    assert (list(inputs), list(outputs)) == documented_ports(VelocityDrive)
    assert inputs == {"velocity": 7, "position": 7}
    assert outputs == {"desired_state": 14, "command_faults": 1, "desired_velocity": 7}


def test_the_measured_position_is_latched_at_initialisation():
    dut, simulator, context = fixed()
    simulator.Initialize()
    np.testing.assert_array_equal(
        dut.GetOutputPort("desired_state").Eval(context), np.concatenate([Q0, np.zeros(7)])
    )


def test_the_desired_velocity_is_the_second_half_of_the_state_and_depends_on_no_input():
    dut, simulator, context = fixed(velocity=0.02)
    simulator.AdvanceTo(2.5 * PERIOD)
    state = dut.GetOutputPort("desired_state").Eval(context)
    np.testing.assert_array_equal(dut.GetOutputPort("desired_velocity").Eval(context), state[7:])
    assert state[7] == 0.02
    assert not dut.HasAnyDirectFeedthrough()


def test_commands_of_the_safety_qp_pass_unchanged():
    """What the drive would clip has been kept before: random requests, new ones every 0.1 s."""
    safety, rng = SafetyFilter(SafetyOptions(period=PERIOD)), np.random.default_rng(5)
    dut, simulator, context = fixed()
    simulator.Initialize()
    q, last, request = Q0, np.zeros(7), np.zeros(7)
    for k in range(1200):
        if k % 20 == 0:
            request = rng.normal(scale=3.0, size=7)
        command = safety.velocity(q, request, qd_last=last)
        dut.GetInputPort("velocity").FixValue(context, command)
        simulator.AdvanceTo((k + 0.5) * PERIOD)
        last = dut.GetOutputPort("desired_velocity").Eval(context).copy()
        np.testing.assert_array_equal(last, command)
        expected = q + PERIOD * command
        q = dut.GetOutputPort("desired_state").Eval(context)[:7].copy()
        np.testing.assert_allclose(q, expected, rtol=0, atol=1e-12)
        dut.GetInputPort("position").FixValue(context, q)


def test_a_zero_command_holds_the_latched_position_though_the_arm_sags():
    states = drive(np.zeros(7), 20, q=Q0)
    sagged = drive(np.zeros(7), 20, q=Q0, follow=False)
    np.testing.assert_array_equal(states, np.tile(np.r_[Q0, np.zeros(7)], (20, 1)))
    np.testing.assert_array_equal(sagged, states)


def test_a_small_command_is_integrated():
    command = np.array([0.1, -0.05, 0.02, 0.1, -0.1, 0.03, 0.2])
    states = drive(command, 100)
    ramp = np.abs(command) / SENT  # time until the command is met
    moved = command * (100 * PERIOD - 0.5 * ramp)
    np.testing.assert_allclose(states[-1, 7:], command, atol=1e-12)
    assert np.all(np.abs(states[-1, :7] - Q0 - moved) <= np.abs(command) * PERIOD)


def test_velocity_and_acceleration_saturate_at_the_limits_of_each_joint():
    signs = np.array([1, -1, 1, -1, 1, -1, 1.0])
    states = drive(10.0 * signs, 80, q=np.zeros(7))
    v = np.vstack([np.zeros(7), states[:, 7:]])
    acceleration = np.diff(v, axis=0) / PERIOD
    np.testing.assert_allclose(acceleration[0], signs * SENT)
    assert np.all(np.abs(acceleration) <= SENT * (1 + 1e-9))
    assert np.all(np.abs(v) <= IIWA_7.velocity_limits * (1 + 1e-12))
    np.testing.assert_allclose(v[-1], signs * IIWA_7.velocity_limits)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_desired_position_never_leaves_the_limits(sign):
    start = sign * 0.95 * IIWA_7.upper
    states = drive(np.full(7, sign * 10.0), 200, q=start)
    # Farther inside than where the driver of the real arm clamps.
    assert np.all(np.abs(states[:, :7]) < IIWA_7.driver.upper - np.deg2rad(0.5))
    margin = IIWA_7.position_margin
    np.testing.assert_allclose(states[-1, :7], sign * (IIWA_7.upper - margin))
    # The desired velocity is that of the desired positions, and comes to rest as it may.
    path = np.vstack([start, states[:, :7]])
    np.testing.assert_allclose(np.diff(path, axis=0) / PERIOD, states[:, 7:], atol=1e-9)
    change = np.diff(np.vstack([np.zeros(7), states[:, 7:]]), axis=0) / PERIOD
    assert np.all(np.abs(change) <= SENT * (1 + 1e-9))


def test_one_margin_keeps_drive_program_and_judge_off_the_limits():
    """Where the drive would stop the arm, the program in front of it has done so before."""
    margin = IIWA_7.position_margin
    assert (IIWA_7.driver.upper < IIWA_7.upper).all()
    assert (IIWA_7.upper - margin < IIWA_7.driver.upper - np.deg2rad(0.5)).all()
    assert SafetyOptions().position_margin >= margin
    assert Reachability().limit_margin >= SafetyOptions().position_margin


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_command_that_is_not_finite_brakes_like_zero(bad):
    def command(stop):
        return lambda k: np.full(7, 0.1) if k < 20 else stop

    broken = np.zeros(7)
    broken[3] = bad
    states = drive(command(broken), 40)
    assert np.isfinite(states).all()
    np.testing.assert_array_equal(states, drive(command(np.zeros(7)), 40))
    np.testing.assert_array_equal(states[-1, 7:], np.zeros(7))


def test_faulty_commands_are_counted():
    dut, simulator, context = fixed()
    for k, command in enumerate([0.1, np.nan, 1e6, 0.2, np.inf]):
        dut.GetInputPort("velocity").FixValue(context, np.full(7, command))
        simulator.AdvanceTo((k + 0.5) * PERIOD)
    assert dut.GetOutputPort("command_faults").Eval(context) == [3.0]


def test_a_blocked_arm_is_not_left_far_behind():
    states = drive(np.full(7, 0.5), 200, q=np.zeros(7), follow=False)
    np.testing.assert_allclose(states[-1, :7], VelocityDrive.MAX_LEAD, atol=0.01)
    change = np.diff(np.vstack([np.zeros(7), states[:, 7:]]), axis=0) / PERIOD
    assert np.all(np.abs(change) <= SENT * (1 + 1e-9))
