"""The joint-space controller in kinematic rollouts, and the solutions it follows."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.joint.law import (
    JointControlOptions,
    JointSpaceControl,
)
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.reach.predicted_reachability import KeepingRule, judge_grasps
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.arm.self_collision import min_distance

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
OPTIONS = JointControlOptions()
NO_CORRIDOR = JointControlOptions(corridor=ApproachCorridor(max_standoff=0.0))
PERIOD, DT = 0.05, 0.005
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
    """Updates solutions at 20 Hz and follows them at 200 Hz, as the system does."""

    def __init__(self, grasps, options=OPTIONS, limit_acceleration=True):
        self.control = JointSpaceControl(REACHABILITY, options, PERIOD)
        self.grasps, self.limit_acceleration = grasps, limit_acceleration
        self.solutions, self.ticks, self.qd = Solutions.empty(), 0, np.zeros(7)
        self.requests = []

    def __call__(self, t, q, X_WO, V_WO):
        if self.ticks % 10 == 0:
            offered = self.grasps(t) if callable(self.grasps) else self.grasps
            self.solutions = self.control.update(self.solutions, t, offered, X_WO, V_WO, q)
        self.ticks += 1
        self.requests.append(self.control.requested_velocity(q, self.solutions, t, X_WO, V_WO))
        last = self.qd if self.limit_acceleration else None
        self.qd = self.control.velocity(q, self.solutions, t, X_WO, V_WO, last)
        return self.qd


def solutions_of(grasps, options=OPTIONS, X_WO=X_WO, q=HOME):
    control = JointSpaceControl(REACHABILITY, options, PERIOD)
    return control, control.update(Solutions.empty(), 0.0, grasps, X_WO, STILL, q)


def in_reach(grasps, X_WO=X_WO, V_WO=STILL):
    return judge_grasps(grasps, X_WO, V_WO, REACHABILITY, rule=KeepingRule(n_best=200)).grasps


@pytest.mark.parametrize("position", [(0.5, 0.0, 0.5), (0.45, -0.25, 0.3)])
def test_it_reaches_a_grasp_of_a_still_object(ring_of_grasps, roll_out, position):
    motion = uniform_motion(position, STILL)
    grasps = in_reach(ring_of_grasps, motion(0.0)[0])
    rollout = roll_out(Controller(grasps), motion, grasps, HOME, 4.0)
    position_mm, angle_deg = rollout.worst_after(3.5)
    assert position_mm < 1.0 and angle_deg < 0.5
    assert rollout.worst_after(0.0)[0] > 100.0
    assert (np.abs(rollout.q) < IIWA_7.position_limits).all()
    assert (np.abs(rollout.qd) <= IIWA_7.velocity_limits).all()
    assert min(min_distance(q) for q in rollout.q[::20]) > 0.0


def test_it_follows_the_papers_line_without_lag(ring_of_grasps, roll_out):
    grasps = in_reach(ring_of_grasps, *papers_line(0.0))
    rollout = roll_out(Controller(grasps), papers_line, grasps, HOME, 5.0)
    position_mm, angle_deg = rollout.worst_after(4.0)
    assert position_mm < 2.0 and angle_deg < 0.5


@pytest.mark.parametrize("feed_forward", [True, False])
def test_without_feed_forward_it_lags_by_speed_over_gain(ring_of_grasps, roll_out, feed_forward):
    """v/k = 12.5 mm at 0.1 m/s and k = 8/s; the first 1.5 s are the transient.

    Of one solution: to change to another one, or to glide along, lags as well.
    """
    motion = uniform_motion([0.5, -0.1, 0.5], np.array([0, 0, 0, 0, 0.1, 0.0]))
    X_WO = motion(0.0)[0]
    grasps = judge_grasps(ring_of_grasps, *motion(0.0), REACHABILITY, horizon=2.0).grasps
    soonest = np.argmin(REACHABILITY.nearest(X_WO @ grasps.X_OG, HOME)[1])
    one = grasps.select(np.array([soonest]))
    close = X_WO @ one.X_OG[0] @ se3.exp([0, 0.05, 0, 0.01, 0, -0.02])
    q = REACHABILITY.nearest(close, HOME)[0][0]
    still = SolutionOptions(per_grasp=1, glide=0.0)
    options = replace(NO_CORRIDOR, feed_forward=feed_forward, solutions=still)
    lag = roll_out(Controller(one, options), motion, one, q, 2.0).worst_after(1.5)[0]
    if feed_forward:
        assert lag < 0.5
    else:
        assert lag == pytest.approx(1e3 * 0.1 / OPTIONS.gain, rel=0.1)


def test_without_grasps_in_reach_the_arm_stops(ring_of_grasps):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    for grasps, X in ((ring_of_grasps, far), (GraspSet.empty(), X_WO)):
        control, solutions = solutions_of(grasps, X_WO=X)
        assert len(solutions) == 0
        qd = control.velocity(HOME, solutions, 0.0, X, np.full(6, 0.2))
        np.testing.assert_allclose(qd, 0.0, atol=1e-9)


@pytest.mark.parametrize("part", ["pose", "twist"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_object_that_is_nowhere_stops_the_arm_and_is_taken_up_again(ring_of_grasps, part, bad):
    grasps = in_reach(ring_of_grasps)
    control, solutions = solutions_of(grasps)
    X, V = X_WO.copy(), np.zeros(6)
    (X if part == "pose" else V)[1] = bad
    qd = control.velocity(HOME, solutions, 0.01, X, V)
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)
    kept = control.update(solutions, PERIOD, grasps, X, V, HOME)
    assert kept is solutions
    assert np.linalg.norm(control.velocity(HOME, kept, PERIOD, X_WO, STILL)) > 0.1
    # A moving arm brakes within its accelerations.
    moving = np.full(7, 0.4)
    qd = control.velocity(HOME, solutions, 0.01, X, V, moving)
    assert (np.abs(qd - moving) <= IIWA_7.acceleration_limits * DT + 1e-9).all()
    assert (np.abs(qd) < 0.4).all()


def test_one_solution_is_approached_in_a_straight_line(ring_of_grasps):
    """With one solution the field is the Euclidean distance: qd = -k (q - q_1), at most."""
    options = replace(NO_CORRIDOR, solutions=SolutionOptions(n_solutions=1))
    control, one = solutions_of(in_reach(ring_of_grasps), options)
    (q_1,) = REACHABILITY.nearest(X_WO @ one.X_OG, HOME)[0][:1]
    velocity = lambda q: control.requested_velocity(q, one, 0.0, X_WO, STILL)  # noqa: E731
    probe = velocity(q_1)
    q_1 = q_1 + probe / OPTIONS.gain if np.linalg.norm(probe) < 0.2 else None
    if q_1 is None:  # the nearest in time is another solution than the nearest in distance
        q = HOME.copy()
        for _ in range(2000):
            q = q + 0.005 * velocity(q)
        q_1 = q
    assert np.linalg.norm(velocity(q_1)) < 1e-3
    close = q_1 + 0.005 * np.array([1, -1, 1, 1, -1, 1, -1])
    np.testing.assert_allclose(velocity(close), OPTIONS.gain * (q_1 - close), atol=1e-3)
    qd, offset = velocity(HOME), q_1 - HOME
    assert qd @ offset == pytest.approx(np.linalg.norm(qd) * np.linalg.norm(offset), rel=1e-6)
    assert np.max(np.abs(qd) / IIWA_7.velocity_limits) <= OPTIONS.max_speed + 1e-9


@pytest.mark.parametrize("turn", [-0.8, 0.3, 1.1])
def test_turning_everything_about_the_base_axis_changes_nothing(ring_of_grasps, turn):
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    grasps = in_reach(ring_of_grasps)
    # Joint limits and obstacles on the way apart, which are not the same all round.
    options = replace(
        NO_CORRIDOR,
        costs=CostWeights(times=(0.0,)),
        solutions=SolutionOptions(per_grasp=1, n_solutions=8),
    )
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
        control, solutions = solutions_of(grasps, options, X, q)
        velocities.append(control.requested_velocity(q, solutions, 0.0, X, V))
    assert np.abs(velocities[0]).max() > 0.1
    np.testing.assert_allclose(velocities[1], velocities[0], atol=1e-3)


def test_what_is_asked_for_does_not_jump_at_updates(ring_of_grasps, roll_out):
    """Grasps come and go at random at every update; the request is as smooth across as between."""
    rng = np.random.default_rng(0)
    grasps = in_reach(ring_of_grasps, *papers_line(0.0))

    def some(t):
        return grasps.select(np.flatnonzero(rng.random(len(grasps)) < 0.7))

    follow = Controller(some)
    roll_out(follow, papers_line, grasps, HOME, 4.0)
    change = np.abs(np.diff(follow.requests, axis=0)).max(axis=1)[1:]
    at_updates, between = change[8::10], np.delete(change, np.arange(8, len(change), 10))
    assert np.quantile(at_updates, 0.9) < 2.0 * np.quantile(between, 0.9) + 0.02
    assert at_updates.max() < 0.5


def test_commands_keep_every_limit_whatever_comes(ring_of_grasps):
    """Random states, grasps, poses and twists, now and then lost; each command follows the last."""
    rng = np.random.default_rng(1)
    grasps, q, qd = ring_of_grasps.with_symmetric(), HOME.copy(), np.zeros(7)
    control, solutions, moved = JointSpaceControl(REACHABILITY), Solutions.empty(), 0
    X, V = X_WO.copy(), STILL
    for k in range(400):
        t = k * DT
        if k % 10 == 0:
            X = se3.random_pose(rng, 1)[0] if rng.random() < 0.1 else X
            X[:3, 3] = rng.uniform(-0.6, 0.6, 3) + [0.0, 0.0, 0.4]
            V = rng.normal(scale=0.5, size=6)
            V[rng.integers(6)] = np.nan if rng.random() < 0.1 else 0.0
            X = np.full((4, 4), np.nan) if rng.random() < 0.1 else np.where(np.isnan(X), X_WO, X)
            some = grasps.select(rng.random(len(grasps)) < 0.2 * rng.integers(0, 3))
            solutions = control.update(solutions, t, some, X, V, q)
        last, qd = qd, control.velocity(q, solutions, t, X, V, qd)
        assert np.isfinite(qd).all()
        assert (np.abs(qd - last) <= IIWA_7.acceleration_limits * DT + 1e-9).all()
        lower, upper = control.safety.problem(q, qd, qd_last=last)[1][:2, :7]
        assert ((lower - 1e-9 <= qd) & (qd <= upper + 1e-9)).all()
        q = q + DT * qd
        assert (np.abs(q) < IIWA_7.position_limits).all()
        moved += bool(np.linalg.norm(qd) > 0.1)
    assert moved > 100
