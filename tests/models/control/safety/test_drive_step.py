"""What is sent keeps its limits by differences of positions, whatever is commanded."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.control.safety.velocity_limits import (
    WILD,
    drive_step_kernel,
    is_fault_kernel,
)
from feasigrasp.models.robot.iiwa import IIWA_7

A, V = IIWA_7.acceleration_share * IIWA_7.acceleration_limits, IIWA_7.velocity_limits
LIMIT = IIWA_7.upper - IIWA_7.position_margin
LEAD = 0.1


def sent(q, commands, *, measured=None, period=0.005, lead=LEAD, speed=1.0):
    """Positions (n + 1, 7) that the arm is sent, and how many commands are faults.

    ``measured`` says where the arm is when the desired position is q; by default just there.
    """
    v, path, velocities, faults = np.zeros(7), [q.copy()], [], 0
    for k, command in enumerate(commands):
        here = q if measured is None else measured(k, q)
        q_next, v_next = np.empty(7), np.empty(7)
        faults += drive_step_kernel(
            IIWA_7.chain, q, v, command, here, (period, lead, speed), q_next, v_next
        )
        q, v = q_next, v_next
        path.append(q)
        velocities.append(v)
    # What is called the desired velocity is the difference of the positions.
    path = np.array(path)
    np.testing.assert_allclose(period * np.array(velocities), np.diff(path, axis=0), atol=1e-12)
    return path, faults


def assert_limits_kept(path, period=0.005, speed=1.0):
    """Position, velocity and acceleration by differences, from rest."""
    assert (np.abs(path) <= LIMIT + 1e-12).all()
    v = np.diff(np.vstack([path[:1], path]), axis=0) / period
    assert (np.abs(v) <= speed * V + 1e-9).all()
    assert (np.abs(np.diff(v, axis=0)) / period <= A * (1.0 + 1e-6) + 1e-6).all()


_SCALES = st.sampled_from([1e-6, 0.1, 1.0, 3.0, 50.0, 1e6, 1e300])


@st.composite
def _walks(draw):
    """A start inside the limits and commands of any size that last for random times."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale, hold = draw(_SCALES), draw(st.sampled_from([1, 7, 50, 400]))
    commands = np.repeat(scale * rng.standard_normal((2000 // hold + 1, 7)), hold, axis=0)
    for bad in draw(st.lists(st.sampled_from([np.nan, np.inf, -np.inf]), max_size=3)):
        commands[rng.random(len(commands)) < 0.05, rng.integers(7)] = bad
    share = draw(st.sampled_from([0.0, 0.9, 0.999, 1.0]))
    return rng, rng.choice([-1.0, 1.0], 7) * share * LIMIT, commands


@settings(max_examples=50, deadline=None)
@given(
    _walks(),
    st.sampled_from([0.001, 0.005, 0.02]),
    st.sampled_from(["ideal", "still", "wild"]),
    st.sampled_from([0.05, 0.2, 1.0]),
)
def test_position_velocity_and_acceleration_keep_their_limits(walk, period, arm, speed):
    """1e5 ticks and more in all, of any command, from any start, wherever the arm is measured."""
    rng, q, commands = walk
    measured = {
        "ideal": None,
        "still": lambda k, _: q,
        "wild": lambda k, there: there + rng.choice([0.01, 1.0, np.nan]) * rng.standard_normal(7),
    }[arm]
    path, _ = sent(q, commands, measured=measured, period=period, speed=speed)
    assert_limits_kept(path, period, speed)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("period", [0.001, 0.005, 0.02])
def test_a_joint_reaches_its_limit_and_stays(sign, period):
    """The bounds are exact: at full speed towards it nothing is given away, and nothing broken."""
    n = round(8.0 / period)
    path, _ = sent(np.zeros(7), np.tile(sign * V, (n, 1)), period=period)
    assert_limits_kept(path, period)
    np.testing.assert_allclose(path[-1], sign * LIMIT, atol=1e-9)
    # No later than speeding up, cruising, and braking take in continuous time, but a few ticks.
    soonest = LIMIT / V + V / A
    late = np.array([np.argmax(np.abs(path[:, i]) > LIMIT[i] - 1e-6) for i in range(7)]) * period
    assert (late <= soonest + 4 * period).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e6, -1e6])
def test_a_faulty_command_brakes_as_hard_as_may_be(bad):
    """One bad entry is enough: the whole command is worth nothing."""
    command = np.full(7, 0.8)
    commands = np.tile(command, (200, 1))
    wrong = command.copy()
    wrong[3] = bad
    commands[100:] = wrong
    path, faults = sent(-0.5 * LIMIT, commands)
    v = np.diff(path, axis=0) / 0.005
    assert faults == 100
    np.testing.assert_allclose(v[99] - v[100], A * 0.005, rtol=1e-6)
    np.testing.assert_allclose(v[-1], 0.0, atol=1e-12)


def test_what_counts_as_a_fault():
    assert not is_fault_kernel(IIWA_7.chain, 0.99 * WILD * V)
    assert is_fault_kernel(IIWA_7.chain, 1.01 * WILD * V)
    assert is_fault_kernel(IIWA_7.chain, np.r_[np.zeros(6), np.nan])


def test_a_blocked_arm_is_waited_for():
    """The desired position stops near the allowed lead, and goes on when the arm comes after."""
    blocked = np.zeros(7)
    path, _ = sent(blocked, np.full((400, 7), 0.5), measured=lambda k, _: blocked)
    assert_limits_kept(path)
    np.testing.assert_allclose(path[-1], LEAD, atol=0.01)  # braking takes some way
    assert (np.diff(path, axis=0) >= -1e-12).all()  # never back
    freed, _ = sent(
        blocked, np.full((800, 7), 0.5), measured=lambda k, q: blocked if k < 400 else q
    )
    assert (freed[-1] > 0.9).all()


def test_from_outside_the_limits_the_way_back_is_open():
    outside = 1.02 * IIWA_7.upper
    path, _ = sent(outside, np.full((400, 7), -0.5))
    assert (path[-1] < LIMIT).all()
    stays, _ = sent(outside, np.full((400, 7), 0.5))
    np.testing.assert_array_equal(stays[-1], outside)
