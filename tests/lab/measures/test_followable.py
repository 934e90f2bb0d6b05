"""Hand poses that the arm can keep up with."""

import numpy as np
import pytest

from feasigrasp.models.ik.closed_form import closed_form
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.peers.drake_arm import DrakeArm
from feasigrasp_lab.studies.arm.followable import is_trackable

DT = 0.02
T = DT * np.arange(-5, 6)
SPEED, ACCELERATION = IIWA_7.velocity_limits[0], IIWA_7.acceleration_limits[0]


def turned(q1):
    """Flange poses by Drake's plant while joint 1 alone moves: no other way keeps the arm angle."""
    bent = np.array([0.0, 0.6, 0.0, -1.2, 0.4, 0.9, 0.2])
    (X,), _ = DrakeArm().pose_and_jacobian(bent[None])
    q = closed_form(X, 0.0)[4]  # an arm angle that is tried
    Q = np.tile(q, (len(q1), 1))
    Q[:, 0] = q1
    return DrakeArm().pose_and_jacobian(Q)[0]


@pytest.mark.parametrize("share, kept", [(0.98, True), (1.02, False)])
def test_a_joint_at_its_limits(share, kept):
    assert is_trackable(turned(share * SPEED * T), DT) == kept
    assert is_trackable(turned(0.5 * share * ACCELERATION * T**2), DT) == kept
    assert is_trackable(turned(0.5 * share * SPEED * T), DT, (0.5, 1.0)) == kept
    assert is_trackable(turned(0.1 * share * ACCELERATION * T**2), DT, (1.0, 0.2)) == kept


def test_a_hand_at_rest_needs_a_configuration_inside_the_limits():
    X = forward_kinematics(IIWA_7.random_positions(np.random.default_rng(0), 60))
    X[::2, :3, 3] *= 1.2  # not all of these are in reach
    expected = [
        any(
            np.isfinite(q).all() and (np.abs(q) <= IIWA_7.position_limits).all()
            for psi in np.linspace(-np.pi, np.pi, 16, endpoint=False)
            for q in closed_form(pose, psi)
        )
        for pose in X
    ]
    assert 10 < sum(expected) < 50
    np.testing.assert_array_equal(is_trackable(np.stack([X] * 3, axis=1), DT), expected)


def test_the_same_way_in_less_time():
    X = turned(0.5 * SPEED * T)
    assert is_trackable(X, DT)
    assert not is_trackable(X, DT / 3.0)


def test_batches_and_what_is_out_of_reach():
    X = np.array([[turned(0.1 * T), turned(2.0 * SPEED * T)]] * 3)
    X[2, :, :, 0, 3] += 1.0
    np.testing.assert_array_equal(is_trackable(X, DT), [[1, 0], [1, 0], [0, 0]])
