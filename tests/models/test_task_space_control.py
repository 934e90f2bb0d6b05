"""The task-space controller in kinematic rollouts, and its symmetries."""

import numpy as np
import pytest

from feasigrasp.models import se3
from feasigrasp.models.grasp_funnel import Funnel
from feasigrasp.models.grasp_lookahead import reachable_grasps
from feasigrasp.models.grasp_mixture import GraspMixture, fit_grasp_mixture
from feasigrasp.models.iiwa import POSITION_LIMITS, VELOCITY_LIMITS
from feasigrasp.models.iiwa_kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.object_motion import HarmonicMotion
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.riemannian_mixture import RiemannianMixture
from feasigrasp.models.self_collision import min_distance
from feasigrasp.models.task_space_control import (
    TaskControlOptions,
    hand_twist_kernel,
    paper_task_space_velocity,
    task_space_velocity,
)

HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
OPTIONS = TaskControlOptions()
NO_FUNNEL = TaskControlOptions(funnel=Funnel(max_standoff=0.0))
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


def mixture_at(grasps, X_WO, V_WO=STILL):
    reachable = reachable_grasps(grasps, X_WO, V_WO, REACHABILITY)
    return fit_grasp_mixture(reachable, 6, np.random.default_rng(0)), reachable


def controller(mixture, options=OPTIONS, feed_forward=1.0):
    return lambda t, q, X_WO, V_WO: task_space_velocity(
        q, mixture, X_WO, feed_forward * V_WO, REACHABILITY, options
    )


def near_a_grasp(X_WO, X_OG):
    """A configuration 2 cm from a grasp."""
    q, time = REACHABILITY.nearest(X_WO @ X_OG @ se3.exp([0, 0.05, 0, 0.01, 0, -0.02]), HOME)
    assert np.isfinite(time[0])
    return q[0]


@pytest.mark.parametrize("position", [(0.5, 0.0, 0.5), (0.45, -0.25, 0.3)])
def test_it_reaches_a_grasp_of_a_still_object(ring_of_grasps, roll_out, position):
    motion = uniform_motion(position, STILL)
    mixture, grasps = mixture_at(ring_of_grasps, motion(0.0)[0])
    rollout = roll_out(controller(mixture), motion, grasps, HOME, 5.0)
    position_mm, angle_deg = rollout.worst_after(4.5)
    assert position_mm < 1.0 and angle_deg < 0.5
    assert rollout.worst_after(0.0)[0] > 100.0
    assert (np.abs(rollout.q) < POSITION_LIMITS).all()
    assert (np.abs(rollout.qd) <= VELOCITY_LIMITS).all()
    assert min(min_distance(q) for q in rollout.q[::20]) > 0.0


def test_it_follows_the_papers_line_without_lag(ring_of_grasps, roll_out):
    """At 14 cm/s and 17 deg/s, from three seconds after the start."""
    mixture, grasps = mixture_at(ring_of_grasps, *papers_line(0.0))
    position_mm, angle_deg = roll_out(
        controller(mixture), papers_line, grasps, HOME, 5.0
    ).worst_after(3.0)
    assert position_mm < 2.0 and angle_deg < 0.5


@pytest.mark.parametrize("feed_forward", [1.0, 0.0])
def test_without_feed_forward_it_lags_by_speed_over_gain(ring_of_grasps, roll_out, feed_forward):
    """v/k = 20 mm at 0.1 m/s and k = 5/s; the first 1.5 s are the transient."""
    motion = uniform_motion([0.5, -0.1, 0.5], np.array([0, 0, 0, 0, 0.1, 0.0]))
    X_WO = motion(0.0)[0]
    grasps = reachable_grasps(ring_of_grasps, *motion(0.0), REACHABILITY, horizon=2.0)
    soonest = np.argmin(REACHABILITY.nearest(X_WO @ grasps.X_OG, HOME)[1])
    one = grasps.select(np.array([soonest]))
    mixture = fit_grasp_mixture(one, 1, np.random.default_rng(0))
    q = near_a_grasp(X_WO, one.X_OG[0])
    rollout = roll_out(controller(mixture, NO_FUNNEL, feed_forward), motion, one, q, 2.0)
    lag = rollout.worst_after(1.5)[0]
    if feed_forward:
        assert lag < 0.5
    else:
        assert lag == pytest.approx(1e3 * 0.1 / OPTIONS.gain, rel=0.05)


def test_nothing_in_reach_stops_the_arm(ring_of_grasps):
    mixture = fit_grasp_mixture(ring_of_grasps, 6, np.random.default_rng(0))
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    qd = task_space_velocity(HOME, mixture, far, np.full(6, 0.2), REACHABILITY, OPTIONS)
    np.testing.assert_allclose(qd, 0.0, atol=1e-9)


@pytest.mark.parametrize("part", ["pose", "twist"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_object_that_is_nowhere_stops_the_arm(ring_of_grasps, part, bad):
    X_WO, V_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5]), np.zeros(6)
    mixture = mixture_at(ring_of_grasps, X_WO)[0]
    (X_WO if part == "pose" else V_WO)[1] = bad
    with np.errstate(all="ignore"):
        qd = task_space_velocity(HOME, mixture, X_WO, V_WO, REACHABILITY, OPTIONS)
        paper = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, OPTIONS)
    np.testing.assert_array_equal(qd, 0.0)
    np.testing.assert_array_equal(paper, 0.0)


@pytest.mark.parametrize("turn", [-0.8, 0.3, 1.1])
def test_turning_everything_about_the_base_axis_changes_nothing(ring_of_grasps, turn):
    X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    mixture = mixture_at(ring_of_grasps, X_WO)[0]
    expected = task_space_velocity(HOME, mixture, X_WO, V_WO, REACHABILITY, OPTIONS)
    assert np.abs(expected).max() > 0.1
    R = se3.so3_exp([0.0, 0.0, turn])
    turned = task_space_velocity(
        HOME + turn * np.eye(7)[0],
        mixture,
        se3.make_pose(R, np.zeros(3)) @ X_WO,
        np.concatenate([R @ V_WO[:3], R @ V_WO[3:]]),
        REACHABILITY,
        OPTIONS,
    )
    np.testing.assert_allclose(turned, expected, atol=1e-7)


def test_the_choice_of_the_object_frame_changes_nothing(ring_of_grasps):
    X_WO = se3.make_pose(se3.so3_exp([0.1, 0.2, 0.3]), [0.5, 0.1, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    mixture = mixture_at(ring_of_grasps, X_WO)[0]
    X_PO = se3.make_pose(se3.so3_exp([-0.7, 0.4, 1.0]), [0.05, -0.1, 0.2])
    X_WP = X_WO @ se3.inverse(X_PO)
    V_WP = carried_twist(V_WO, X_WP[:3, 3] - X_WO[:3, 3])
    moved = GraspMixture(mixture.mixture.transformed(X_PO), X_PO @ mixture.X_OG, mixture.component)
    np.testing.assert_allclose(
        task_space_velocity(HOME, moved, X_WP, V_WP, REACHABILITY, OPTIONS),
        task_space_velocity(HOME, mixture, X_WO, V_WO, REACHABILITY, OPTIONS),
        atol=1e-7,
    )


def components_at(X_OG):
    """A mixture with one component, and one member, per pose."""
    n = len(X_OG)
    covariance = np.tile(np.diag([0.01] * 3 + [1e-4] * 3), (n, 1, 1))
    return GraspMixture(RiemannianMixture(np.full(n, 1 / n), X_OG, covariance), X_OG, np.arange(n))


def test_a_component_out_of_reach_counts_nothing(ring_of_grasps):
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    within = mixture_at(ring_of_grasps, X_WO)[1].X_OG[0]
    beyond = within.copy()
    beyond[:3, 3] += [1.5, 0.0, 0.0]
    one, two = components_at(within[None]), components_at(np.stack([within, beyond]))
    np.testing.assert_allclose(
        task_space_velocity(HOME, two, X_WO, STILL, REACHABILITY, OPTIONS),
        task_space_velocity(HOME, one, X_WO, STILL, REACHABILITY, OPTIONS),
        atol=1e-12,
    )


def test_the_component_that_is_sooner_reached_wins():
    """Two grasps at the same distance in the field; joint 7 is much nearer to one of them."""
    X_WH = forward_kinematics(HOME, X_FG)
    turns = [se3.exp([0, 0, angle, 0, 0, 0]) for angle in (0.5, -0.5)]
    q = HOME + 0.3 * np.eye(7)[6]
    J = pose_and_jacobian(q, X_FG)[1]
    mixture = components_at(X_WH @ np.array(turns))
    V_WH = J @ task_space_velocity(q, mixture, np.eye(4), STILL, REACHABILITY, OPTIONS)
    # Turning on about the approach direction (with joint 7), not back.
    assert V_WH[:3] @ forward_kinematics(q, X_FG)[:3, 2] > 0.3


def test_the_papers_law_follows_the_mixture(ring_of_grasps):
    """J qd is the object's twist plus the preconditioned direction, and converges to a mean."""
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    V_WO = np.array([0.1, -0.1, 0.2, 0.05, 0.1, -0.03])
    mixture = mixture_at(ring_of_grasps, X_WO)[0]
    X_WH, J = pose_and_jacobian(HOME, X_FG)
    qd = paper_task_space_velocity(HOME, mixture, X_WO, V_WO, X_FG, OPTIONS)
    relative = J @ qd - carried_twist(V_WO, X_WH[:3, 3] - X_WO[:3, 3])
    body = np.concatenate([X_WH[:3, :3].T @ relative[:3], X_WH[:3, :3].T @ relative[3:]])
    direction = mixture.mixture.direction((se3.inverse(X_WO) @ X_WH)[None])[0]
    cosine = body @ direction / np.linalg.norm(body) / np.linalg.norm(direction)
    assert cosine == pytest.approx(1.0)
    assert np.linalg.norm(body[3:]) <= OPTIONS.max_linear + 1e-9
    assert np.linalg.norm(body[:3]) <= OPTIONS.max_angular + 1e-9

    q = HOME
    for _ in range(800):
        q = q + 0.005 * paper_task_space_velocity(q, mixture, X_WO, STILL, X_FG, OPTIONS)
    X_OH = se3.inverse(X_WO) @ forward_kinematics(q, X_FG)
    assert np.linalg.norm(se3.log(se3.inverse(mixture.mixture.means) @ X_OH), axis=1).min() < 0.05


def test_a_relative_twist_is_shortened_in_its_direction():
    def shortened(u, max_angular, max_linear):
        return hand_twist_kernel(u, np.eye(4), np.eye(4), STILL, max_angular, max_linear)

    u = np.array([3.0, 0.0, 0.0, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(shortened(u, 1.5, 0.4), u / 2)
    np.testing.assert_allclose(shortened(u, 1.5, 0.04), u / 2.5)
    np.testing.assert_array_equal(shortened(u, 4.0, 0.2), u)
    np.testing.assert_array_equal(shortened(STILL, 1.5, 0.4), STILL)


@pytest.mark.parametrize("relative", [False, True])
def test_the_hands_twist_by_finite_differences(relative):
    """Of a hand that moves in the body frame while the object carries it along."""
    rng = np.random.default_rng(3)
    X_WO, X_OH = se3.random_pose(rng, 2)
    V_WO, u_H, h = rng.normal(size=6), relative * rng.normal(size=6), 1e-6
    ahead, behind = (se3.extrapolate(X_WO, V_WO, dt) @ X_OH @ se3.exp(dt * u_H) for dt in (h, -h))
    V = hand_twist_kernel(u_H, X_WO @ X_OH, X_WO, V_WO, np.inf, np.inf)
    np.testing.assert_allclose(V[3:], (ahead - behind)[:3, 3] / (2 * h), atol=1e-8)
    angular = se3.so3_log(ahead[:3, :3] @ behind[:3, :3].T) / (2 * h)
    np.testing.assert_allclose(V[:3], angular, atol=1e-8)
