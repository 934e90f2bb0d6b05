"""Errors of joint sensors: within the band of the data sheet, drawn once, with noise in time."""

import numpy as np
import pytest

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.sensors.joint_errors import DrawnJointErrors, JointErrors

Q = np.random.default_rng(0).uniform(-2.0, 2.0, (400, 7))


def arm_of(seed, **sizes):
    return DrawnJointErrors(JointErrors(**sizes), IIWA_7.effort_limits, seed)


def test_external_torques_are_within_two_percent_and_noise():
    arms = [arm_of(seed, torque_noise=0.0) for seed in range(20)]
    shares = np.array([[a.torque(np.zeros(7), q, 0.0) for q in Q] for a in arms])
    shares /= IIWA_7.effort_limits
    assert 0.012 < np.abs(shares).max() <= 0.02
    assert shares.mean(axis=1).std() > 0.003  # arms differ
    noisy = arm_of(1, torque_accuracy=0.0)
    noise = np.array([noisy.torque(np.zeros(7), Q[0], t) for t in np.arange(500) * 0.0025])
    np.testing.assert_allclose(noise.std(axis=0), 0.005 * IIWA_7.effort_limits, rtol=0.15)
    np.testing.assert_array_equal(noise[3], noisy.torque(np.zeros(7), Q[0], 0.0075))


def test_positions_come_in_steps_from_a_zero_that_stays():
    arm = arm_of(3)
    measured = np.array([arm.position(q) for q in Q])
    steps = np.rad2deg(measured) / 0.01
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    error = np.rad2deg(measured - Q)
    np.testing.assert_allclose(error.mean(axis=0), np.rad2deg(arm.zero), atol=0.001)
    assert error.std(axis=0).max() == pytest.approx(0.01 / np.sqrt(12.0), rel=0.15)
    zeros = [arm_of(seed).zero for seed in range(100)]
    assert np.rad2deg(np.std(zeros)) == pytest.approx(0.02, rel=0.1)


def test_without_errors_nothing_changes():
    arm = DrawnJointErrors(JointErrors().scaled(0.0), IIWA_7.effort_limits, 3)
    np.testing.assert_array_equal(arm.position(Q[0]), Q[0])
    np.testing.assert_array_equal(arm.torque(Q[1], Q[0], 1.0), Q[1])
