"""Limits of motions whose velocities and accelerations are known in closed form."""

import numpy as np
import pytest

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.runs.metrics.motion_limits import WINDOW, limit_metrics

PERIOD = 0.005
V, A = IIWA_7.velocity_limits, IIWA_7.acceleration_limits
TIME = np.arange(400)[:, None] * PERIOD


def sent(position):
    """Figures of positions (m, 7) that are sent to an arm at rest."""
    return limit_metrics(position, np.zeros_like(position), PERIOD, PERIOD)


def moved(velocity):
    """Figures of a true motion of an arm that is sent nothing."""
    return limit_metrics(np.zeros_like(velocity), velocity, PERIOD, PERIOD)


def ramp(*shares):
    """Positions whose second differences are these shares of what the limits allow."""
    return np.cumsum(np.cumsum(np.outer(shares, A * PERIOD**2), axis=0), axis=0)


def test_a_motion_at_its_limits_keeps_them():
    found = sent(1.0 + ramp(0.0, 1.0, 1.0, -1.0, -1.0))
    assert found["velocity_limit_violation_percent"] == 0.0
    assert found["acceleration_limit_violation_percent"] == 0.0
    assert found["acceleration_peak_percent"] == pytest.approx(100.0)


def test_one_joint_in_one_tick_counts():
    q = ramp(0.0, 0.5, 0.5, 0.5, 0.5)
    q[3:, 4] += 0.6 * A[4] * PERIOD**2  # one step more, which is kept: 1.1, then 0.5 - 0.6
    found = sent(q)
    assert found["acceleration_limit_violation_percent"] == pytest.approx(20.0)
    assert found["acceleration_peak_percent"] == pytest.approx(110.0)
    assert found["velocity_limit_violation_percent"] == 0.0


def test_a_drive_that_clips_nothing_is_found_out():
    """Random velocities of 50 rad/s, integrated: every tick is beyond both limits."""
    commands = np.random.default_rng(0).uniform(-50.0, 50.0, (200, 7))
    found = sent(np.cumsum(PERIOD * commands, axis=0))
    assert found["velocity_limit_violation_percent"] > 99.0
    assert found["acceleration_limit_violation_percent"] > 99.0
    assert found["acceleration_peak_percent"] > 1e4


def test_a_position_that_stops_dead_is_found_out():
    """As at a joint limit where positions are cut off: the velocity says nothing of it."""
    q = 0.5 * V * TIME
    found = sent(np.minimum(q, q[200]))
    assert found["velocity_limit_violation_percent"] == 0.0
    # From rest to half the limit at the start, and from there to rest: two ticks.
    assert found["acceleration_limit_violation_percent"] == pytest.approx(100.0 * 2 / 400)
    assert found["acceleration_peak_percent"] == pytest.approx(100.0 * (0.5 * V / PERIOD / A).max())


@pytest.mark.parametrize("share", [0.2, 0.9, 1.2])
def test_a_sine_has_the_peaks_of_its_derivatives(share):
    """q = a (1 - cos wt) / w^2: velocity a / w sin wt, acceleration a cos wt."""
    rate, a = 12.0, share * A.min() * np.eye(7)[1]
    position, velocity = a * (1 - np.cos(rate * TIME)) / rate**2, a * np.sin(rate * TIME) / rate
    found, true = sent(position), moved(velocity)
    assert A.argmin() == 1
    for peak in (found["acceleration_peak_percent"], true["true_acceleration_peak_percent"]):
        assert peak == pytest.approx(100.0 * share, rel=0.01)
    assert (found["acceleration_limit_violation_percent"] > 0.0) == (share > 1.0)
    assert (true["true_acceleration_violation_percent"] > 0.0) == (share > 1.0)
    assert true["acceleration_limit_violation_percent"] == 0.0
    assert true["velocity_peak_percent"] == pytest.approx(100.0 * (a / rate / V).max(), rel=1e-3)


@pytest.mark.parametrize("which", ["sent", "velocity"])
def test_too_fast_is_too_fast_as_sent_or_in_truth(which):
    ticks = dict.fromkeys(("sent", "velocity"), np.zeros((400, 7)))
    velocity = np.zeros((400, 7))
    velocity[100:300, 0] = -1.01 * V[0]
    ticks[which] = velocity if which == "velocity" else np.cumsum(PERIOD * velocity, axis=0)
    found = limit_metrics(**ticks, period=PERIOD, step=PERIOD)
    assert found["velocity_limit_violation_percent"] == 50.0
    expected = 101.0 if which == "velocity" else 0.0
    assert found["velocity_peak_percent"] == pytest.approx(expected)


def test_the_true_acceleration_leaves_out_noise_from_step_to_step():
    """A velocity that alternates between steps has no mean acceleration over the window."""
    noise = np.tile(0.05 * (-1.0) ** np.arange(400)[:, None], 7)
    assert (np.abs(np.diff(noise, axis=0) / PERIOD) > A).any()
    assert moved(noise)["true_acceleration_peak_percent"] < 1e-9


def test_the_true_acceleration_counts_where_nothing_too_quick_was_sent():
    """One joint, beyond its limit for 100 of 400 ticks: as long, but for the ends of the window."""
    share = np.where((np.arange(400) >= 100) & (np.arange(400) < 200), 1.1, 0.0)
    velocity = np.outer(np.cumsum(share * A[2] * PERIOD), np.eye(7)[2])
    found, lag = moved(velocity), round(WINDOW / PERIOD)
    beyond = 100 - lag + 1
    assert found["true_acceleration_violation_percent"] == pytest.approx(
        100.0 * beyond / (400 - lag)
    )
    assert found["true_acceleration_peak_percent"] == pytest.approx(110.0)


def test_a_single_tick_is_at_rest():
    found = sent(np.ones((1, 7)))
    assert found["acceleration_limit_violation_percent"] == 0.0
    assert found["velocity_limit_violation_percent"] == 0.0
    assert found["true_acceleration_peak_percent"] is None
