"""Joints that keep to their bounds can always keep to them: exact, for thousands of steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.arrays import record
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.control.safety.velocity_limits import bounds_kernel, braking_speed
from feasigrasp.models.robot.iiwa import IIWA_7

OPTIONS = SafetyOptions()
CAPACITY = OPTIONS.velocity_scale * IIWA_7.velocity_limits


def velocity_bounds(q, options, qd_last=None):
    """Lower and upper bounds, shape (7,) each."""
    lower, upper = np.empty(7), np.empty(7)
    bounds_kernel(
        IIWA_7.chain,
        q,
        np.empty(0) if qd_last is None else qd_last,
        record(options)[0],
        lower,
        upper,
    )
    return lower, upper


positions = st.lists(st.floats(-1.5, 1.5), min_size=7, max_size=7).map(
    lambda x: np.array(x) * IIWA_7.upper
)


@settings(deadline=None)
@given(positions)
def test_bounds_lead_away_from_the_limits_and_fade_towards_them(q):
    lower, upper = velocity_bounds(q, OPTIONS)
    assert (lower <= upper).all()
    assert (np.abs(lower) <= CAPACITY).all() and (np.abs(upper) <= CAPACITY).all()
    room = IIWA_7.upper - OPTIONS.position_margin - np.abs(q)
    towards = np.where(q > 0, upper, -lower)
    inside = room > 0
    assert (towards[inside] >= 0).all() and (towards[~inside] <= 0).all()
    # Half of the joint's acceleration stops it within the room that is left.
    braking = towards[inside] ** 2 / IIWA_7.acceleration_limits[inside]
    assert (braking <= room[inside] + 1e-12).all()
    middle = np.abs(q) < 0.2
    np.testing.assert_allclose(upper[middle], CAPACITY[middle])
    np.testing.assert_allclose(lower[middle], -CAPACITY[middle])


@given(st.floats(1e-6, 3.0), st.floats(0.5, 20.0), st.floats(1e-3, 0.05))
def test_braking_from_the_braking_speed_uses_up_exactly_the_room(room, deceleration, period):
    v, way = braking_speed(room, deceleration, period), 0.0
    while v > 0:
        way += period * v
        v -= deceleration * period
    assert way == pytest.approx(room, rel=1e-9)


def requests(kind, rng, n):
    """Requests (n, 7) of every kind, many times faster than the joints."""
    if kind == "random":
        return rng.normal(scale=5.0, size=(n, 7))
    if kind == "constant":
        return np.tile(10.0 * rng.choice([-1.0, 1.0], 7), (n, 1))
    hold = rng.integers(5, 120)
    return np.repeat(rng.normal(scale=5.0, size=(n // hold + 1, 7)), hold, axis=0)[:n]


@pytest.mark.parametrize("kind", ["random", "constant", "held"])
@pytest.mark.parametrize("period", [0.002, 0.005, 0.02])
def test_the_interval_is_never_empty_and_no_limit_is_ever_passed(kind, period):
    """What the proof in `velocity_limits` says, over 3000 steps."""
    options = SafetyOptions(period=period)
    rng = np.random.default_rng(1)
    limit = IIWA_7.upper - options.position_margin
    change = options.acceleration_scale * IIWA_7.acceleration_limits * period
    q, last = rng.uniform(-0.99, 0.99, 7) * limit, np.zeros(7)
    nearest = np.full(7, np.inf)
    for request in requests(kind, rng, 3000):
        lower, upper = velocity_bounds(q, options, last)
        free_lower, free_upper = velocity_bounds(q, options)
        # The bounds of position and velocity are met without giving up on the accelerations.
        tolerance = 1e-9
        assert (upper <= free_upper + tolerance).all() and (lower >= free_lower - tolerance).all()
        assert (lower <= upper).all()
        qd = np.clip(request, lower, upper)
        assert (np.abs(qd - last) <= change * (1 + tolerance)).all()
        q, last = q + period * qd, qd
        assert (np.abs(q) <= limit + tolerance).all()
        nearest = np.minimum(nearest, limit - np.abs(q))
    if kind == "constant":
        assert (nearest < 0.01).all()  # the limits are reached, not shunned


@settings(deadline=None)
@given(positions, st.lists(st.floats(-2.0, 2.0), min_size=7, max_size=7).map(np.array))
def test_acceleration_comes_first_where_not_all_can_be_kept(q, share):
    last = share * CAPACITY
    change = OPTIONS.acceleration_scale * IIWA_7.acceleration_limits * OPTIONS.period
    lower, upper = velocity_bounds(q, OPTIONS, last)
    assert (lower <= upper).all()
    assert (lower >= last - change - 1e-12).all() and (upper <= last + change + 1e-12).all()


def lagging(commands, period, gain=100.0):
    """Velocities of a joint with critical damping that is sent these, by small steps."""
    q, v, wish, reached = 0.0, 0.0, 0.0, []
    fine = 10
    for command in commands:
        for _ in range(fine):
            wish += command * period / fine
            v += (gain * (wish - q) + 2.0 * np.sqrt(gain) * (command - v)) * period / fine
            q += v * period / fine
        reached.append(v)
    return np.array(reached)


def test_an_arm_that_lags_does_not_overshoot_the_speed_limit():
    """All joints accelerate as hard as they may; without `speed_gain` they would be too fast."""
    reached = {}
    for speed_gain in (OPTIONS.speed_gain, 1e3):
        options, last, sent = SafetyOptions(speed_gain=speed_gain), np.zeros(7), []
        for _ in range(150):
            _, last = velocity_bounds(np.zeros(7), options, last)
            sent.append(last)
        arm = [lagging(joint, options.period) for joint in np.transpose(sent)]
        reached[speed_gain] = np.max(np.array(arm).max(axis=1) / IIWA_7.velocity_limits)
        np.testing.assert_allclose(last, CAPACITY, rtol=0.05)
    assert reached[OPTIONS.speed_gain] < 1.0 < reached[1e3]


@settings(deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=7, max_size=7).map(np.array), st.floats(0.05, 0.9))
def test_slowing_down_is_bounded_by_the_acceleration_alone(share, scale):
    options = SafetyOptions(velocity_scale=scale)
    last = share * options.velocity_scale * IIWA_7.velocity_limits
    change = options.acceleration_scale * IIWA_7.acceleration_limits * options.period
    lower, upper = velocity_bounds(np.zeros(7), options, last)
    slower = np.sign(last) * np.maximum(np.abs(last) - change, 0.0)
    assert (lower <= slower + 1e-12).all() and (upper >= slower - 1e-12).all()
