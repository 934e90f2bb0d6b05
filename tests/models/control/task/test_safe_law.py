"""The task-space controller in kinematic rollouts, and its symmetries."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feasigrasp.models.control.safety.safe_velocity import SafetyFilter
from feasigrasp.models.control.task import safe_law
from feasigrasp.models.control.task.choice import ChoiceOptions, GraspChoice
from feasigrasp.models.control.task.grasp_mixture import GraspMixture, fit_grasp_mixture
from feasigrasp.models.control.task.memory import TaskMemory
from feasigrasp.models.control.task.safe_law import TaskControlOptions, task_space_velocity
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.mixtures.mixture import RiemannianMixture
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.reach.predicted_reachability import judge_grasps
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.arm.self_collision import min_distance
from feasigrasp_lab.paper.task_law import PaperTaskOptions, paper_task_space_velocity

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
OPTIONS = TaskControlOptions()
NO_CORRIDOR = TaskControlOptions(choice=ChoiceOptions(corridor=ApproachCorridor(max_standoff=1e-4)))
SAFETY = SafetyFilter(OPTIONS.safety, REACHABILITY.gripper)
PERIOD = OPTIONS.safety.period
STILL = np.zeros(6)


def carried_twist(V_WO, p_OG_W):
    """Twist, at its own origin, of a frame that is fixed to the object."""
    return np.concatenate([V_WO[:3], V_WO[3:] + np.cross(V_WO[:3], p_OG_W)])


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
    """Adapts at 20 Hz and commands at 200 Hz, as the system does; accelerations are limited.

    ``motion(t)`` predicts the object; without it the twist counts as constant.
    """

    def __init__(self, grasps, options=OPTIONS, motion=None):
        self.grasps, self.options = grasps, options
        self.motion = motion
        self.memory, self.qd, self.ticks = TaskMemory(), np.zeros(7), 0

    def __call__(self, t, q, X_WO, V_WO):
        if self.ticks % 10 == 0:
            instants = self.options.choice.costs.instants_from(
                t, self.memory.choice.interception_time
            )
            if self.motion is None:
                ahead = [se3.extrapolate(X_WO, V_WO, s) for s in instants]
            else:
                ahead = [self.motion(t + s)[0] for s in instants]
            self.memory = self.memory.with_grasps(self.grasps, 10, 0).with_choice(
                t, q, np.array(ahead), REACHABILITY, self.options.choice
            )
        self.ticks += 1
        self.qd = task_space_velocity(
            q,
            self.memory.choice,
            X_WO,
            V_WO,
            REACHABILITY,
            SAFETY,
            self.options,
            time=t,
            qd_last=self.qd,
        )
        return self.qd


def command(q, grasps, X_WO, V_WO, options=OPTIONS):
    """The first command, accelerations not limited, and the choice."""
    controller = Controller(grasps, options)
    controller(0.0, q, X_WO, V_WO)
    choice = controller.memory.choice
    qd = task_space_velocity(q, choice, X_WO, V_WO, REACHABILITY, SAFETY, options)
    return qd, choice


def within_reach(grasps, X_WO, V_WO=STILL, **options):
    return judge_grasps(grasps, X_WO, V_WO, REACHABILITY, **options).grasps


def near_a_grasp(X_WO, X_OG):
    """A configuration 2 cm from a grasp."""
    q, time = REACHABILITY.nearest(X_WO @ X_OG @ se3.exp([0, 0.05, 0, 0.01, 0, -0.02]), HOME)
    assert np.isfinite(time[0])
    return q[0]


@pytest.mark.parametrize("position", [(0.5, 0.0, 0.5), (0.45, -0.25, 0.3)])
def test_it_reaches_a_grasp_of_a_still_object(ring_of_grasps, roll_out, position):
    motion = uniform_motion(position, STILL)
    grasps = within_reach(ring_of_grasps, motion(0.0)[0])
    rollout = roll_out(Controller(grasps), motion, grasps, HOME, 5.0)
    position_mm, angle_deg = rollout.worst_after(4.5)
    assert position_mm < 1.0 and angle_deg < 0.5
    assert rollout.worst_after(0.0)[0] > 100.0
    assert (np.abs(rollout.q) < IIWA_7.position_limits).all()
    assert (np.abs(rollout.qd) <= IIWA_7.velocity_limits).all()
    assert min(min_distance(q) for q in rollout.q[::20]) > 0.0


def test_it_follows_the_papers_line_without_lag(ring_of_grasps, roll_out):
    """At 14 cm/s and 17 deg/s, from three seconds after the start."""
    grasps = within_reach(ring_of_grasps, *papers_line(0.0))
    controller = Controller(grasps, motion=papers_line)
    rollout = roll_out(controller, papers_line, grasps, HOME, 5.0)
    position_mm, angle_deg = rollout.worst_after(3.0)
    assert position_mm < 2.0 and angle_deg < 0.5


@pytest.mark.parametrize("feed_forward", [True, False])
def test_without_feed_forward_it_lags_by_speed_over_gain(ring_of_grasps, roll_out, feed_forward):
    """v/k = 20 mm at 0.1 m/s and k = 5/s; the first 1.5 s are the transient."""
    motion = uniform_motion([0.5, -0.1, 0.5], np.array([0, 0, 0, 0, 0.1, 0.0]))
    X_WO = motion(0.0)[0]
    grasps = within_reach(ring_of_grasps, *motion(0.0), horizon=2.0)
    soonest = np.argmin(REACHABILITY.nearest(X_WO @ grasps.X_OG, HOME)[1])
    one = grasps.select(np.array([soonest]))
    q = near_a_grasp(X_WO, one.X_OG[0])
    options = replace(NO_CORRIDOR, feed_forward=feed_forward)
    rollout = roll_out(Controller(one, options), motion, one, q, 2.0)
    lag = rollout.worst_after(1.5)[0]
    if feed_forward:
        assert lag < 0.5
    else:
        assert lag == pytest.approx(1e3 * 0.1 / OPTIONS.gain, rel=0.1)


def test_nothing_in_reach_stops_the_arm(ring_of_grasps):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    qd, choice = command(HOME, ring_of_grasps, far, np.full(6, 0.2))
    assert not choice
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)


@pytest.mark.parametrize("part", ["pose", "twist"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_object_that_is_nowhere_stops_the_arm(ring_of_grasps, part, bad):
    X_WO, V_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5]), np.zeros(6)
    grasps = within_reach(ring_of_grasps, X_WO)
    _, choice = command(HOME, grasps, X_WO, V_WO)
    mixture = fit_grasp_mixture(grasps, 10, np.random.default_rng(0))
    (X_WO if part == "pose" else V_WO)[1] = bad
    moving = np.full(7, 0.3)
    with np.errstate(all="ignore"):
        where = choice, X_WO, V_WO, REACHABILITY, SAFETY, OPTIONS
        qd = task_space_velocity(HOME, *where)
        braking = task_space_velocity(HOME, *where, qd_last=moving)
        paper = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, PaperTaskOptions())
    np.testing.assert_allclose(qd, 0.0, atol=1e-12)
    np.testing.assert_array_equal(paper, 0.0)
    assert (braking >= 0.0).all() and (braking < moving).all()
    assert (moving - braking <= IIWA_7.acceleration_limits * PERIOD + 1e-12).all()


@pytest.mark.parametrize("turn", [-0.8, 0.3, 1.1])
def test_turning_everything_about_the_base_axis_changes_nothing(ring_of_grasps, turn):
    """Except that joint 1 is nearer to its limit, which is far here."""
    X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    grasps = within_reach(ring_of_grasps, X_WO)
    expected, choice = command(HOME, grasps, X_WO, V_WO)
    assert np.abs(expected).max() > 0.1
    R = se3.so3_exp([0.0, 0.0, turn])
    turned = task_space_velocity(
        HOME + turn * np.eye(7)[0],
        choice,
        se3.make_pose(R, np.zeros(3)) @ X_WO,
        np.concatenate([R @ V_WO[:3], R @ V_WO[3:]]),
        REACHABILITY,
        SAFETY,
        OPTIONS,
    )
    np.testing.assert_allclose(turned, expected, atol=1e-6)


def in_another_frame(choice, X_PO):
    moved = GraspChoice(**vars(choice))
    object.__setattr__(moved, "X_OG", X_PO @ choice.X_OG)
    return moved


def test_the_choice_of_the_object_frame_changes_nothing(ring_of_grasps):
    """Left-invariance: means, grasps and hand move together with the object.

    On the way to a far configuration the hand is kept near the object's origin, so there it does.
    """
    X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    grasps = within_reach(ring_of_grasps, X_WO)
    mixture = fit_grasp_mixture(grasps, 10, np.random.default_rng(0))
    soonest = np.argmin(REACHABILITY.nearest(X_WO @ grasps.X_OG, HOME)[1])
    q = near_a_grasp(X_WO, grasps.X_OG[soonest])
    branch = int(4 * (q[3] < 0) + 2 * (q[1] < 0) + (q[5] < 0))
    choice = GraspChoice(grasps.X_OG[soonest], branch, arm_angle_kernel(q))
    qd = task_space_velocity(q, choice, X_WO, V_WO, REACHABILITY, SAFETY, OPTIONS)
    assert np.abs(qd).max() > 0.1
    X_PO = se3.make_pose(se3.so3_exp([-0.7, 0.4, 1.0]), [0.05, -0.1, 0.2])
    X_WP = X_WO @ se3.inverse(X_PO)
    V_WP = carried_twist(V_WO, X_WP[:3, 3] - X_WO[:3, 3])
    moved = in_another_frame(choice, X_PO)
    np.testing.assert_allclose(
        task_space_velocity(q, moved, X_WP, V_WP, REACHABILITY, SAFETY, OPTIONS), qd, atol=1e-3
    )
    in_P = RiemannianMixture(
        mixture.mixture.weights, X_PO @ mixture.mixture.means, mixture.mixture.covariances
    )
    in_P = GraspMixture(in_P, X_PO @ mixture.X_OG, mixture.component, mixture.medoid)
    np.testing.assert_allclose(
        paper_task_space_velocity(HOME, in_P, X_WP, V_WP, X_FG, PaperTaskOptions()),
        paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, PaperTaskOptions()),
        atol=1e-7,
    )


def test_a_grasp_out_of_reach_counts_nothing(ring_of_grasps):
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    one = within_reach(ring_of_grasps, X_WO).select(np.array([0]))
    beyond = one.X_OG.copy()
    beyond[:, :3, 3] += [1.5, 0.0, 0.0]
    two = GraspSet(np.concatenate([one.X_OG, beyond]), np.full(2, 0.05), np.ones(2))
    np.testing.assert_allclose(
        command(HOME, two, X_WO, STILL)[0], command(HOME, one, X_WO, STILL)[0], atol=1e-12
    )


@pytest.mark.parametrize("mode", ["safe", "paper"])
@pytest.mark.parametrize("seed", range(4))
def test_random_states_and_grasps_give_finite_commands(mode, seed):
    rng = np.random.default_rng(seed)
    for _ in range(15):
        n = int(rng.integers(1, 12))
        X_OG = se3.random_pose(rng, n)
        X_OG[:, :3, 3] *= 0.1
        grasps = GraspSet(X_OG, np.full(n, 0.05), rng.uniform(0, 1, n))
        q = rng.uniform(-1, 1, 7) * IIWA_7.position_limits
        X_WO = se3.make_pose(se3.random_pose(rng, 1)[0, :3, :3], rng.uniform(-0.7, 0.7, 3))
        V_WO = rng.normal(size=6)
        if mode == "paper":
            mixture = fit_grasp_mixture(grasps, 10, rng)
            qd = paper_task_space_velocity(q, mixture, X_WO, V_WO, X_FG, PaperTaskOptions())
        else:
            qd = command(q, grasps, X_WO, V_WO)[0]
            assert (np.abs(qd) <= IIWA_7.velocity_limits).all()
        assert np.isfinite(qd).all()


EVENTS = st.lists(
    st.sampled_from(["same", "other grasps", "fewer", "none", "lost", "jump", "late"]),
    min_size=3,
    max_size=8,
)


@given(EVENTS, st.integers(0, 2**16))
@settings(max_examples=12, deadline=None)
def test_whatever_comes_in_the_command_never_jumps(events, seed):
    """Every 0.1 s something happens to the grasps or to the pose; accelerations stay in limits."""
    rng = np.random.default_rng(seed)
    X_OG = se3.random_pose(rng, 30)
    X_OG[:, :3, 3] *= 0.05
    everything = GraspSet(X_OG, np.full(30, 0.05), rng.uniform(0.1, 1, 30))
    controller, q, t = Controller(everything), HOME, 0.0
    motion = uniform_motion([0.5, 0.0, 0.5], np.array([0.1, 0, 0.3, 0, 0.1, 0]))
    last = np.zeros(7)
    for event in events:
        keep = rng.random(30) < {"fewer": 0.3, "other grasps": 0.6, "none": 0.0}.get(event, 1.0)
        controller.grasps = everything.select(keep)
        offset = se3.exp(0.3 * rng.normal(size=6)) if event == "jump" else np.eye(4)
        for _ in range(20):
            X_WO, V_WO = motion(t - 0.05 * (event == "late"))
            X_WO = X_WO @ offset
            if event == "lost":
                X_WO = np.full((4, 4), np.nan)
            qd = controller(t, q, X_WO, V_WO)
            assert np.isfinite(qd).all()
            assert (np.abs(qd - last) <= IIWA_7.acceleration_limits * PERIOD + 1e-9).all(), event
            assert (np.abs(qd) <= IIWA_7.velocity_limits).all()
            q, last, t = q + PERIOD * qd, qd, t + PERIOD
            assert (np.abs(q) <= IIWA_7.position_limits).all()


def a_strand(X_WO, turn):
    """A grasp from above with a turned hand, and where the arm holds it."""
    R_WG = se3.so3_exp([0.0, 0.0, turn]) @ se3.so3_exp([np.pi, 0.0, 0.0])
    X_OG = se3.inverse(X_WO) @ se3.make_pose(R_WG, X_WO[:3, 3])
    q, time = REACHABILITY.nearest(X_WO @ X_OG, HOME)
    assert np.isfinite(time[0])
    branch = int(4 * (q[0, 3] < 0) + 2 * (q[0, 1] < 0) + (q[0, 5] < 0))
    return GraspChoice(X_OG, branch, arm_angle_kernel(q[0]))


def on_the_way(choice, motion, duration):
    """How far the hand is from its grasp at last [m]."""
    q, qd = HOME.copy(), np.zeros(7)
    for k in range(round(duration / PERIOD)):
        where = (q, choice, *motion(k * PERIOD), REACHABILITY, SAFETY, NO_CORRIDOR)
        qd = task_space_velocity(*where, time=k * PERIOD, qd_last=qd)
        q = q + PERIOD * qd
    goal = (motion(duration)[0] @ choice.X_OG)[:3, 3]
    return np.linalg.norm(forward_kinematics(q, X_FG)[:3, 3] - goal)


def quick_circle(t):
    """0.6 m/s about a point in front of the arm."""
    c, s = np.cos(5.0 * t), np.sin(5.0 * t)
    X_WO = se3.make_pose(np.eye(3), [0.5 + 0.12 * c, 0.12 * s, 0.3])
    return X_WO, np.array([0.0, 0.0, 0.0, -0.6 * s, 0.6 * c, 0.0])


@pytest.mark.parametrize("turn", [0.0, 1.0, 2.0])
def test_far_away_the_arm_goes_to_where_its_strand_will_be_when_it_is_due(monkeypatch, turn):
    """As the tracker knows the circle; one that runs after the strand is late."""
    monkeypatch.setattr(safe_law, "object_at_interception", lambda *a: quick_circle(1.3))
    choice = a_strand(quick_circle(1.3)[0], turn)
    met = on_the_way(replace(choice, interception_time=1.3), quick_circle, 1.3)
    followed = on_the_way(replace(choice, interception_time=-1.0), quick_circle, 1.3)
    assert met < 0.6 * followed


@pytest.mark.parametrize(
    ("below", "speed", "meets"), [(0.35, 0.6, True), (0.1, 0.6, False), (0.35, 0.15, False)]
)
def test_only_a_quick_object_that_is_not_in_the_way_is_met(below, speed, meets):
    p_WH, X_WO = np.array([0.5, 0.0, 0.45]), np.eye(4)
    q, time = REACHABILITY.nearest(se3.make_pose(se3.so3_exp([np.pi, 0.0, 0.0]), p_WH), HOME)
    assert np.isfinite(time[0])
    X_WO[:3, 3] = p_WH - [0.0, 0.0, below]
    choice, V_WO = a_strand(X_WO, 2.0), np.array([0.0, 0.0, 0.0, 0.0, speed, 0.0])
    met, followed = (
        task_space_velocity(
            *(
                q[0],
                replace(choice, interception_time=interception_time),
                X_WO,
                V_WO,
                REACHABILITY,
                SAFETY,
                OPTIONS,
            ),
            qd_last=np.zeros(7),
        )
        for interception_time in (1.0, -1.0)
    )
    assert np.abs(followed).max() > 1e-3
    assert (np.abs(met - followed).max() > 1e-3) == meets


def test_the_request_does_not_jump_when_what_is_met_is_due(monkeypatch):
    """What is left of the way is followed: a meeting's share is gone, whatever it asks for."""
    asked, shares = [], []
    monkeypatch.setattr(
        safe_law, "interception_velocity", lambda *a: asked.append(a[4]) or np.ones(7)
    )
    choice, motion = a_strand(quick_circle(0.0)[0], 2.0), quick_circle(0.0)
    times = np.array([0.5, 0.31, 0.25, 0.2, 0.16, 0.14, 0.05])
    keeps = SimpleNamespace(velocity=lambda q, qd, *a, **k: qd)
    for left in times:
        met, followed = (
            task_space_velocity(
                *(
                    HOME,
                    replace(choice, interception_time=interception_time),
                    *motion,
                    REACHABILITY,
                    keeps,
                    NO_CORRIDOR,
                ),
                qd_last=np.zeros(7),
            )
            for interception_time in (left, -1.0)
        )
        shares.append(np.median((met - followed) / (1.0 - followed)))
    np.testing.assert_allclose(shares, np.clip(times / 0.15 - 1.0, 0.0, 1.0), atol=1e-9)
    assert asked == list(times[times > 0.15])
