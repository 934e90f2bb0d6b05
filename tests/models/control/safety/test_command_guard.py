"""The guard: what it sends keeps the limits, and ends at rest if its controller dies."""

import numpy as np
import pytest

from feasigrasp.errors import ControlError
from feasigrasp.models.control.safety.command_guard import CommandGuard
from feasigrasp.models.robot.iiwa import IIWA_7

T = 0.005
START = np.array([0.1, -0.5, 0.2, -1.2, 0.0, 1.0, 0.3])


def simulated(request, seconds, *, status=lambda k: True, speed=1.0):
    """Commands to an arm that is where it was sent, one row a period; NaN where there is none."""
    guard, q, sent = CommandGuard(T, speed), START.copy(), []
    for k in range(round(seconds / T)):
        if not status(k):
            sent.append(np.full(7, np.nan))
            continue
        command = guard.command(k * T, q, q, k * T)
        wanted = request(k * T)
        if wanted is not None:
            guard.request(k * T, wanted)
        sent.append(np.full(7, np.nan) if command is None else command)
        q = q if command is None else command
    return np.array(sent), guard


def swing(t):
    return START + 0.2 * np.sin(2.0 * t) * np.array([1, 0.5, 1, 0.5, 1, 1, 1])


def keeps_limits(sent, speed=1.0):
    moved = np.vstack([START, sent[np.isfinite(sent).all(axis=1)]])
    v = np.diff(moved, axis=0, prepend=moved[:1]) / T
    a = np.diff(v, axis=0, prepend=0.0) / T
    assert (np.abs(v) <= speed * IIWA_7.velocity_limits * (1 + 1e-9)).all()
    assert (np.abs(a) <= IIWA_7.acceleration_limits * (1 + 1e-6)).all()
    return v


def test_it_is_silent_until_the_driver_takes_commands():
    sent, _ = simulated(swing, 0.5)
    assert np.isnan(sent[: round(0.25 / T) + 1]).all()
    np.testing.assert_allclose(sent[60], START, atol=1e-3)


def test_it_follows_what_is_asked_for():
    sent, _ = simulated(swing, 3.0)
    times = np.arange(len(sent)) * T
    wanted = np.array([swing(t) for t in times[300:]])
    assert np.abs(sent[300:] - wanted).max() < 2e-4
    keeps_limits(sent)


def test_what_is_left_is_made_up_for_without_haste_near_the_speed_limit():
    """Requests that have come late are far off: an arm overshoots a speed reached at full tilt."""
    sent, _ = simulated(lambda t: START + 0.2 * (t > 1.0), 2.1)
    v = keeps_limits(sent) / (CommandGuard.SPEED * IIWA_7.velocity_limits)
    share = CommandGuard.SPEED_GAIN * T
    assert (np.diff(v, axis=0) <= share * (1.0 - v[:-1]) + 1e-9)[v[:-1] > 0.0].all()
    assert v.max() > 0.75
    np.testing.assert_allclose(sent[-1], START + 0.2, atol=1e-4)


def test_a_controller_that_dies_leaves_the_arm_at_rest():
    speed = np.abs(0.4 * np.cos(2.0 * 2.5))
    sent, guard = simulated(lambda t: swing(t) if t < 2.5 else None, 4.0)
    v = keeps_limits(sent)
    moving = np.flatnonzero(np.abs(v).max(axis=1) > 0.0)[-1] - len(v) + len(sent)
    braking = speed / (IIWA_7.acceleration_share * IIWA_7.acceleration_limits.min())
    assert moving * T <= 2.5 + CommandGuard.DEADLINE + braking + 2 * T
    assert not guard.moving and not guard.received


@pytest.mark.parametrize(
    "strange",
    [
        lambda t: swing(t) + 2.0 * (t > 1.0),  # far away all at once
        lambda t: swing(t) * np.where(t > 1.0, np.nan, 1.0),
        lambda t: START + 0.02 * np.random.default_rng(round(1e4 * t)).standard_normal(7),
        lambda t: swing(t)[:5] if t > 1.0 else swing(t),
    ],
)
def test_whatever_is_asked_for_the_limits_are_kept(strange):
    keeps_limits(simulated(strange, 2.0)[0])


def test_late_and_doubled_requests_are_not_used():
    guard = CommandGuard(T)
    for k in range(100):
        guard.command(k * T, START, START, k * T)
    assert guard.request(1.0, START) and guard.request(1.005, START)
    assert not guard.request(1.005, START) and not guard.request(0.9, START)
    for k in range(100, 200):  # long silent: another controller may begin, with a clock of its own
        guard.command(k * T, START, START, k * T)
    assert guard.request(0.1, START)


def test_after_a_pause_of_the_driver_it_begins_anew():
    gap = range(300, 360)
    sent, _ = simulated(lambda t: swing(1.5) if t > 1.5 else swing(t), 3.0,
                        status=lambda k: k not in gap)  # fmt: skip
    assert np.isnan(sent[360 : 360 + round(0.25 / T)]).all()
    assert np.isfinite(sent[-1]).all()


@pytest.mark.parametrize("speed", [0.2, 0.01])
def test_a_slow_arm_is_never_faster_whatever_is_requested(speed):
    """Of requests as fast as the whole arm, and of one far away, it takes its share."""
    for request in (lambda t: START + 0.24 * np.sin(6.0 * t), lambda t: START + 0.2):
        sent, guard = simulated(request, 3.0, speed=speed)
        v = keeps_limits(sent, speed)
        assert np.abs(v).max() > 0.9 * speed * IIWA_7.velocity_limits.min()
    with pytest.raises(ControlError, match="speed = 20.0; give a finite number above 0"):
        CommandGuard(T, 20.0)
