"""The joint-space controller in kinematic rollouts, and the solutions it follows."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models import se3
from feasigrasp.models.grasp_funnel import Funnel, funnel_targets
from feasigrasp.models.grasp_lookahead import reachable_grasps
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa import POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.iiwa_kinematics import forward_kinematics
from feasigrasp.models.joint_space_control import (
    JointControlOptions,
    Solutions,
    find_solutions,
    joint_space_velocity,
)
from feasigrasp.models.object_motion import HarmonicMotion
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.self_collision import min_distance

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
OPTIONS = JointControlOptions()
NO_FUNNEL = JointControlOptions(funnel=Funnel(max_standoff=0.0))
STILL = np.zeros(6)
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])


def uniform_motion(p_WO, V_WO):
    start = se3.make_pose(np.eye(3), p_WO)
    return lambda t: (se3.extrapolate(start, V_WO, t), V_WO)


def papers_line(t):
    motion = HarmonicMotion(
        center=np.array([0.45, 0.0, 0.2]),
        amplitude=np.array([0.0, 0.45, 0.1]),
        harmonic=np.ones(3),
        offset_deg=np.zeros(3),
        rate=0.3,
        start_phase=0.0,
        spin_axis=np.array([1.0, 0.0, 0.0]),
        spin=0.3,
    )
    return motion.pose(t), motion.velocity(t)


class Controller:
    """Finds solutions at 20 Hz and follows them at 200 Hz, as the system does."""

    def __init__(self, grasps, options=OPTIONS, feed_forward=1.0):
        self.grasps, self.options, self.feed_forward = grasps, options, feed_forward
        self.ticks = 0

    def __call__(self, t, q, X_WO, V_WO):
        if self.ticks % 10 == 0:
            self.solutions = find_solutions(self.grasps, X_WO, q, REACHABILITY, self.options)
        self.ticks += 1
        return joint_space_velocity(
            q, self.solutions, X_WO, self.feed_forward * V_WO, REACHABILITY, self.options
        )


def in_reach(grasps, X_WO=X_WO, V_WO=STILL):
    return reachable_grasps(grasps, X_WO, V_WO, REACHABILITY)


@pytest.mark.parametrize("position", [(0.5, 0.0, 0.5), (0.45, -0.25, 0.3)])
def test_it_reaches_a_grasp_of_a_still_object(ring_of_grasps, roll_out, position):
    motion = uniform_motion(position, STILL)
    grasps = in_reach(ring_of_grasps, motion(0.0)[0])
    rollout = roll_out(Controller(grasps), motion, grasps, HOME, 5.0)
    position_mm, angle_deg = rollout.worst_after(4.5)
    assert position_mm < 1.0 and angle_deg < 0.5
    assert rollout.worst_after(0.0)[0] > 100.0
    assert (np.abs(rollout.q) < POSITION_LIMITS).all()
    assert (np.abs(rollout.qd) <= VELOCITY_LIMITS).all()
    assert min(min_distance(q) for q in rollout.q[::20]) > 0.0


def test_it_follows_the_papers_line_without_lag(ring_of_grasps, roll_out):
    grasps = in_reach(ring_of_grasps, *papers_line(0.0))
    rollout = roll_out(Controller(grasps), papers_line, grasps, HOME, 6.0)
    position_mm, angle_deg = rollout.worst_after(5.0)
    assert position_mm < 2.0 and angle_deg < 0.5


@pytest.mark.parametrize("feed_forward", [1.0, 0.0])
def test_without_feed_forward_it_lags_by_speed_over_gain(ring_of_grasps, roll_out, feed_forward):
    """v/k = 20 mm at 0.1 m/s and k = 5/s; the first 1.5 s are the transient."""
    motion = uniform_motion([0.5, -0.1, 0.5], np.array([0, 0, 0, 0, 0.1, 0.0]))
    X_WO = motion(0.0)[0]
    grasps = reachable_grasps(ring_of_grasps, *motion(0.0), REACHABILITY, horizon=2.0)
    soonest = np.argmin(REACHABILITY.nearest(X_WO @ grasps.X_OG, HOME)[1])
    one = grasps.select(np.array([soonest]))
    close = X_WO @ one.X_OG[0] @ se3.exp([0, 0.05, 0, 0.01, 0, -0.02])
    q = REACHABILITY.nearest(close, HOME)[0][0]
    rollout = roll_out(Controller(one, NO_FUNNEL, feed_forward), motion, one, q, 2.0)
    lag = rollout.worst_after(1.5)[0]
    if feed_forward:
        assert lag < 0.5
    else:
        assert lag == pytest.approx(1e3 * 0.1 / OPTIONS.gain, rel=0.05)


def test_solutions_reach_the_funnel_targets_soonest_first(ring_of_grasps):
    grasps = in_reach(ring_of_grasps)
    solutions = find_solutions(grasps, X_WO, HOME, REACHABILITY, OPTIONS)
    assert 5 < len(solutions.q) <= len(grasps)
    X_OH = se3.inverse(X_WO) @ forward_kinematics(HOME, X_FG)
    targets = X_WO @ funnel_targets(solutions.X_OG, X_OH, OPTIONS.funnel)
    np.testing.assert_allclose(forward_kinematics(solutions.q, X_FG), targets, atol=1e-9)
    travel = np.max(np.abs(solutions.q - HOME) / VELOCITY_LIMITS, axis=1)
    assert (np.diff(travel) >= 0).all()

    few = find_solutions(grasps, X_WO, HOME, REACHABILITY, replace(OPTIONS, n_solutions=4))
    np.testing.assert_array_equal(few.q, solutions.q[:4])


def test_no_solutions_for_what_is_out_of_reach(ring_of_grasps):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    for grasps, X in ((ring_of_grasps, far), (GraspSet.empty(), X_WO)):
        solutions = find_solutions(grasps, X, HOME, REACHABILITY, OPTIONS)
        assert solutions.q.shape == (0, 7) and solutions.X_OG.shape == (0, 4, 4)
        qd = joint_space_velocity(HOME, solutions, X, STILL, REACHABILITY, OPTIONS)
        np.testing.assert_allclose(qd, 0.0, atol=1e-9)


def test_solutions_that_cannot_be_continued_stop_the_arm(ring_of_grasps):
    """The object has jumped out of reach since they were found."""
    solutions = find_solutions(in_reach(ring_of_grasps), X_WO, HOME, REACHABILITY, OPTIONS)
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    qd = joint_space_velocity(HOME, solutions, far, np.full(6, 0.2), REACHABILITY, OPTIONS)
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)


@pytest.mark.parametrize("part", ["pose", "twist"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_object_that_is_nowhere_stops_the_arm(ring_of_grasps, part, bad):
    solutions = find_solutions(in_reach(ring_of_grasps), X_WO, HOME, REACHABILITY, OPTIONS)
    X, V = X_WO.copy(), np.zeros(6)
    (X if part == "pose" else V)[1] = bad
    with np.errstate(all="ignore"):
        qd = joint_space_velocity(HOME, solutions, X, V, REACHABILITY, OPTIONS)
    np.testing.assert_array_equal(qd, 0.0)


def test_one_solution_is_approached_in_a_straight_line(ring_of_grasps):
    """With one solution the field is the Euclidean distance: qd = -k (q - q_1), at most."""
    grasps = in_reach(ring_of_grasps)
    one = find_solutions(grasps, X_WO, HOME, REACHABILITY, replace(NO_FUNNEL, n_solutions=1))
    velocity = lambda q: joint_space_velocity(  # noqa: E731
        q, one, X_WO, STILL, REACHABILITY, NO_FUNNEL, enforce_limits=False
    )
    close = one.q[0] + 0.01 * np.array([1, -1, 1, 1, -1, 1, -1])
    np.testing.assert_allclose(velocity(close), OPTIONS.gain * (one.q[0] - close), atol=1e-4)
    qd, offset = velocity(HOME), one.q[0] - HOME
    assert qd @ offset == pytest.approx(np.linalg.norm(qd) * np.linalg.norm(offset), rel=1e-6)
    assert np.max(np.abs(qd) / VELOCITY_LIMITS) == pytest.approx(OPTIONS.max_speed)


def test_at_a_solution_the_arm_moves_as_the_object_does(ring_of_grasps):
    """The hand's twist is the object's, carried to the hand."""
    grasps = in_reach(ring_of_grasps)
    one = find_solutions(grasps, X_WO, HOME, REACHABILITY, replace(NO_FUNNEL, n_solutions=1))
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    q, h = one.q[0], 1e-5
    qd = joint_space_velocity(q, one, X_WO, V_WO, REACHABILITY, NO_FUNNEL, enforce_limits=False)
    moved = forward_kinematics(q + h * qd, X_FG)
    expected = se3.extrapolate(X_WO, V_WO, h) @ one.X_OG[0]
    # The damped inverse leaves a little.
    change = np.abs(expected - X_WO @ one.X_OG[0]).max()
    np.testing.assert_allclose(moved, expected, atol=0.05 * change)


@pytest.mark.parametrize("turn", [-0.8, 0.3, 1.1])
def test_turning_everything_about_the_base_axis_changes_nothing(ring_of_grasps, turn):
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    grasps = in_reach(ring_of_grasps)
    R = se3.so3_exp([0.0, 0.0, turn])
    velocities = []
    for q, X, V in (
        (HOME, X_WO, V_WO),
        (
            HOME + turn * np.eye(7)[0],
            se3.make_pose(R, np.zeros(3)) @ X_WO,
            np.concatenate([R @ V_WO[:3], R @ V_WO[3:]]),
        ),
    ):
        solutions = find_solutions(grasps, X, q, REACHABILITY, replace(OPTIONS, n_solutions=8))
        velocities.append(joint_space_velocity(q, solutions, X, V, REACHABILITY, OPTIONS))
    assert np.abs(velocities[0]).max() > 0.1
    np.testing.assert_allclose(velocities[1], velocities[0], atol=1e-6)


def test_solutions_are_immutable(ring_of_grasps):
    solutions = find_solutions(in_reach(ring_of_grasps), X_WO, HOME, REACHABILITY, OPTIONS)
    assert copy.deepcopy(solutions) is solutions
    before = solutions.q.copy()
    joint_space_velocity(HOME, solutions, X_WO, STILL, REACHABILITY, OPTIONS)
    np.testing.assert_array_equal(solutions.q, before)
    with pytest.raises(ValueError, match="read-only"):
        solutions.q[0] = 0.0
    assert len(Solutions.empty().q) == 0
