"""The reference against its ends, forward kinematics and finite differences."""

from dataclasses import dataclass

import numpy as np
import pytest

from feasigrasp.models.control.horizon.knots import Meeting
from feasigrasp.models.control.horizon.reference import INSTANT, reference_kernel
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from tests.plan_knots import knots_at, neighbours

X_FG = se3.make_pose(se3.so3_exp([0.0, 0.0, 0.4]), [0.0, 0.0, 0.15])
X_WO = se3.make_pose(se3.so3_exp([0.3, -0.2, 0.5]), [0.5, 0.1, 0.4])
V_WO = np.array([0.1, -0.2, 0.4, 0.1, 0.2, -0.1])
STILL = np.zeros(6)
DIRECT, CORRIDOR = ApproachCorridor(max_standoff=0.0), ApproachCorridor()
#: The arm now, at the interception, and holding the grasp now.
Q, Q_THERE = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1]), np.full(7, 0.35)
Q_GRASP = Q + np.array([0.3, -0.2, 0.1, 0.2, -0.3, 0.1, 0.2])
V, V_THERE = np.linspace(-0.4, 0.5, 7), np.linspace(0.3, -0.2, 7)
#: The hand in the object's frame, beside the grasp.
OFFSET = se3.make_pose(np.eye(3), [0.03, 0.0, -0.01])


@dataclass
class Reference:
    """Positions and velocities of the reference, shares of the standoff, and object poses."""

    q: np.ndarray
    v: np.ndarray
    share: np.ndarray
    X_WO: np.ndarray
    standoff: float
    X_OG: np.ndarray

    def target(self, k):
        """The grasp at the object's pose, pulled back."""
        X_WT = self.X_WO[k] @ self.X_OG
        X_WT[:3, 3] -= self.share[k] * self.standoff * X_WT[:3, 2]
        return X_WT


def reference(times, twist=V_WO, *, q=Q, q_grasp=Q_GRASP, left=0.0, near=0.0, corridor=CORRIDOR):
    """Reference to the grasp that ``q_grasp`` holds now of an object with a constant twist."""
    times = np.array(times, dtype=float)
    poses = np.array([se3.extrapolate(X_WO, twist, t) for t in times])
    after = np.array([se3.extrapolate(X_WO, twist, t + INSTANT) for t in times])
    X_OG = se3.inverse(X_WO) @ forward_kinematics(q_grasp, X_FG)
    X_OH = X_OG @ OFFSET
    hand = poses @ X_OH, np.zeros((len(times), 6, 7))
    knots = knots_at(
        np.zeros((len(times), 7)), X_FG, poses, times=times, X_WO_after=after, hand=hand
    )
    held = [branch_kernel(IIWA_7.chain, q_grasp)], [arm_angle_kernel(IIWA_7.chain, q_grasp)]
    meeting = Meeting(q, V, left, Q_THERE, V_THERE)
    q_ref, v_ref = np.empty((2, len(times), 7))
    reference_kernel(
        *(knots, neighbours(X_OG[None], None, *held), meeting, corridor.parameters),
        *(se3.inverse(X_FG), near, q_ref, v_ref),
    )
    share = knots.share
    standoff = standoff_kernel(X_OG, X_OH, corridor.parameters)
    return Reference(q_ref, v_ref, share, poses, standoff, X_OG)


@pytest.mark.parametrize("left", [0.3, 1.0])
def test_at_its_ends_it_has_the_states_of_arm_and_interception(left):
    found = reference([0.0, left - 1e-9], left=left)
    np.testing.assert_allclose(found.q, [Q, Q_THERE], atol=1e-8)
    np.testing.assert_allclose(found.v, [V, V_THERE], atol=1e-7)


def test_in_between_it_is_the_motion_of_least_squared_acceleration():
    """Whose acceleration is linear in time; and its velocity is the derivative."""
    times = np.linspace(0.0, 0.999, 41)
    found = reference(times, left=1.0)
    jerk = np.diff(found.q, 3, axis=0) / np.diff(times)[0] ** 3
    assert np.abs(jerk).max() > 1.0
    np.testing.assert_allclose(jerk, np.tile(jerk[0], (len(jerk), 1)), atol=1e-8)
    # Simpson's rule is exact for the velocity, a parabola.
    v, step = found.v, np.diff(times)[0]
    way = step / 3.0 * (v[:-2:2] + 4.0 * v[1:-1:2] + v[2::2])
    np.testing.assert_allclose(way, found.q[2::2] - found.q[:-2:2], atol=1e-12)


@pytest.mark.parametrize("corridor", [DIRECT, CORRIDOR], ids=["direct", "corridor"])
def test_after_the_arrival_the_hand_is_at_the_pulled_back_grasp(corridor):
    times = np.linspace(0.0, 0.6, 7)
    found = reference(times, left=0.25, corridor=corridor)
    assert found.standoff == (0.0 if corridor is DIRECT else pytest.approx(0.088))
    for k in np.flatnonzero(times >= 0.25):
        X_WH = forward_kinematics(found.q[k], X_FG)
        np.testing.assert_allclose(X_WH, found.target(k), atol=1e-6)
        assert branch_kernel(IIWA_7.chain, found.q[k]) == branch_kernel(IIWA_7.chain, Q_GRASP)
        assert arm_angle_kernel(IIWA_7.chain, found.q[k]) == pytest.approx(
            arm_angle_kernel(IIWA_7.chain, Q_GRASP), abs=1e-6
        )


def test_after_the_arrival_its_velocity_is_the_derivative():
    """In the middle of the instant over which it is taken."""
    step, times = 1e-3, np.linspace(0.0, 0.5, 6)
    v = reference(times).v
    ahead, behind = (reference(times + 0.5 * INSTANT + s).q for s in (step, -step))
    assert np.abs(v).max() > 0.3
    np.testing.assert_allclose(v, (ahead - behind) / (2 * step), atol=2e-4)


def test_a_grasp_that_rests_is_waited_at():
    found = reference([0.1, 0.5], STILL)
    np.testing.assert_allclose(found.q[0], found.q[1], atol=1e-9)
    np.testing.assert_array_equal(found.v, np.zeros((2, 7)))


def test_joints_that_are_near_follow_at_once():
    far = reference([0.1, 0.2], left=1.0, near=0.3, q=Q_GRASP + 0.4, corridor=DIRECT)
    near = reference([0.1, 0.2], left=1.0, near=0.3, q=Q_GRASP + 0.1, corridor=DIRECT)
    for k in range(2):
        np.testing.assert_allclose(forward_kinematics(near.q[k], X_FG), near.target(k), atol=1e-6)
        assert np.abs(forward_kinematics(far.q[k], X_FG) - far.target(k)).max() > 0.05


def test_out_of_reach_the_configuration_of_the_interception_is_kept():
    away = np.array([0.0, 0.0, 0.0, 2.0, 0.0, 0.0])
    found = reference([0.0, 1.0], away)
    assert not np.allclose(found.q[0], Q_THERE)
    np.testing.assert_array_equal(found.q[1], Q_THERE)
    np.testing.assert_array_equal(found.v[1], np.zeros(7))


def test_velocities_that_no_joint_has_are_none():
    """Three times the limit, as next to a singularity."""
    for speed, moves in ((1.0, True), (30.0, False)):
        found = reference([0.0], np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0]))
        assert found.v.any() == moves
        assert np.abs(found.v / IIWA_7.velocity_limits).max() < 3.0


def test_of_the_standoff_as_much_is_kept_as_the_joint_limits_allow():
    """The elbow is bent as far as it goes: the hand cannot draw back by all of it."""
    limits = np.array(IIWA_7.upper) - IIWA_7.position_margin
    shares = []
    for bend in np.linspace(0.0, 0.3, 13):
        q_grasp = np.array([0.1, 0.3, 0.1, limits[3] - bend, 0.1, 1.0, 0.1])
        found = reference([0.0], STILL, q_grasp=q_grasp)
        np.testing.assert_allclose(forward_kinematics(found.q[0], X_FG), found.target(0), atol=1e-6)
        assert (np.abs(found.q[0]) <= limits + 1e-9).all()
        shares.append(found.share[0])
    assert set(shares) > {0.0, 1.0}
    assert (np.diff(shares) >= 0.0).all()
