"""Shares of ticks beyond the limits, from motions made by hand."""

import numpy as np
import pytest

from feasigrasp.evaluation.runs.motion_limits import JointTicks, limit_metrics
from feasigrasp.models.robot.iiwa import IIWA_7

PERIOD = 0.005
STEP = IIWA_7.acceleration_limits * PERIOD


def ramp(*shares):
    """Velocities that change by these shares of what the acceleration limits allow."""
    return np.cumsum(np.outer(shares, STEP), axis=0)


def test_a_motion_at_its_limits_keeps_them():
    v = ramp(0.0, 1.0, 1.0, -1.0, -1.0)
    found = limit_metrics(JointTicks(v, v, PERIOD))
    assert found["velocity_limit_violation_percent"] == 0.0
    assert found["acceleration_limit_violation_percent"] == 0.0
    assert found["acceleration_peak_percent"] == pytest.approx(100.0)
    still = np.tile(IIWA_7.velocity_limits, (5, 1))
    found = limit_metrics(JointTicks(still, -still, PERIOD))
    assert found["velocity_limit_violation_percent"] == 0.0
    assert found["velocity_peak_percent"] == pytest.approx(100.0)


def test_one_joint_in_one_tick_counts():
    v = ramp(0.0, 0.5, 0.5, 0.5, 0.5)
    v[3, 4] += 0.6 * STEP[4]  # faster up by 0.1 than allowed, then down by 0.1
    found = limit_metrics(JointTicks(v, v, PERIOD))
    assert found["acceleration_limit_violation_percent"] == pytest.approx(25.0)
    assert found["acceleration_peak_percent"] == pytest.approx(110.0)
    assert found["velocity_limit_violation_percent"] == 0.0


@pytest.mark.parametrize("which", ["commanded", "measured"])
def test_too_fast_is_too_fast_in_the_command_or_in_truth(which):
    ticks = {"commanded": np.zeros((4, 7)), "measured": np.zeros((4, 7))}
    ticks[which][1:3, 0] = -1.01 * IIWA_7.velocity_limits[0]
    found = limit_metrics(JointTicks(**ticks, period=PERIOD))
    assert found["velocity_limit_violation_percent"] == 50.0
    expected = 101.0 if which == "measured" else 0.0
    assert found["velocity_peak_percent"] == pytest.approx(expected)


def test_the_acceleration_is_that_of_the_command():
    v = np.zeros((3, 7))
    jerky = np.array([np.zeros(7), 5.0 * STEP, np.zeros(7)])
    assert limit_metrics(JointTicks(v, jerky, PERIOD))["acceleration_limit_violation_percent"] == 0
    found = limit_metrics(JointTicks(jerky, v, PERIOD))
    assert found["acceleration_limit_violation_percent"] == 100.0


def test_a_single_tick_has_no_acceleration():
    found = limit_metrics(JointTicks(np.zeros((1, 7)), np.zeros((1, 7)), PERIOD))
    assert found["acceleration_limit_violation_percent"] is None
    assert found["velocity_limit_violation_percent"] == 0.0
