"""Touch: noticed by external torques, told from their noise, and given way to."""

import numpy as np
import pytest

from feasigrasp.models.control.planning.touch import (
    THRESHOLD,
    touch_state,
    touch_step_kernel,
    yielding_velocity,
)
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.models.sensors.joint_errors import DrawnJointErrors, JointErrors

PERIOD = 0.002
Q = np.array([0.1, 0.55, 0.2, -1.6, 0.3, 0.99, 0.4])
J = pose_and_jacobian(Q, ParallelGripper().X_FG)[1]


def sensed(torques):
    """States after each of the external torques."""
    state, states = touch_state(7), []
    for torque in torques:
        after = np.empty(len(state))
        touch_step_kernel(IIWA_7.chain, state, np.asarray(torque, dtype=float), PERIOD, after)
        state = after
        states.append(state)
    return np.array(states)


def reported(torques, factor, seed, turning=1.5):
    """What an arm of which all joints turn [rad/s] reports of external torques, by its errors."""
    arm, times = (
        DrawnJointErrors(JointErrors().scaled(factor), IIWA_7.effort_limits, seed),
        PERIOD * np.arange(10**6),
    )
    return [arm.torque(tau, Q + turning * t, t) for tau, t in zip(torques, times, strict=False)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_errors_of_the_arms_own_estimate_are_no_touch(factor, seed):
    """60 s each, at the published size (2 % of the largest torque) and at twice that."""
    states = sensed(reported([np.zeros(7)] * 30000, factor, seed))
    assert states[-1, 15] == 0
    assert not states[:, 7:14].any()


@pytest.mark.parametrize("factor", [0.0, 1.0])
def test_ten_newtons_at_the_hand_are_noticed_in_20_ms_and_forgotten_after(factor):
    """From any side; the arm gives way for 0.2 s and no longer, and counts one touch."""
    rng, noticed = np.random.default_rng(1), 0
    for _ in range(20):
        F = rng.normal(size=3)
        torque = J[3:].T @ (10.0 * F / np.linalg.norm(F))
        if np.max(np.abs(torque) / IIWA_7.effort_limits) < 1.5 * THRESHOLD:
            continue  # along the arm
        torques = [np.zeros(7)] * 500 + [torque] * 50 + [np.zeros(7)] * 200
        states = sensed(reported(torques, factor, noticed))[500:]
        touched = states[:, 7:14].any(axis=1)
        assert 0 < np.argmax(touched) * PERIOD < 0.02
        assert not touched[-1] and touched[120] and states[-1, 15] == 1
        direction = states[49, 7:14] / np.linalg.norm(states[49, 7:14])
        error = direction - torque / np.linalg.norm(torque)
        np.testing.assert_allclose(error, 0.0, atol=1e-9 if factor == 0.0 else 0.5)
        noticed += 1
    assert noticed >= 15


def test_a_torque_that_is_not_finite_is_none():
    states = sensed([np.full(7, np.nan)] * 20 + [np.full(7, np.inf)] * 20)
    assert np.isfinite(states).all() and states[-1, 15] == 0


@pytest.mark.parametrize("seed", range(5))
def test_a_hand_that_is_pushed_moves_along_the_push(seed):
    """With 0.1 m/s at least, and no farther from what was wanted than that takes."""
    rng = np.random.default_rng(seed)
    F, wanted = rng.normal(size=3), rng.normal(scale=0.5, size=7)
    torque = J[3:].T @ F
    qd = yielding_velocity(wanted, torque, J)
    speed = F @ (J[3:] @ qd) / np.linalg.norm(F)
    before = F @ (J[3:] @ wanted) / np.linalg.norm(F)
    np.testing.assert_allclose(speed, max(0.1, before), atol=1e-9)
    change = qd - wanted
    np.testing.assert_allclose(
        change - torque * (torque @ change) / (torque @ torque), 0, atol=1e-9
    )


def test_without_a_touch_nothing_changes():
    qd = np.arange(7.0)
    assert yielding_velocity(qd, np.zeros(7), J) is qd
