"""The choice of a grasp: admissible, unaffected by order, committed, and in time."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.planning.cost_weights import CostWeights, instant_at
from feasigrasp.models.control.task.choice import ChoiceOptions, GraspChoice, choose_grasp
from feasigrasp.models.control.task.pursuit import PursuitOptions, pursuit_velocity
from feasigrasp.models.control.task.reference import candidate_reference
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.self_motion import arm_angle, closed_form
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

REACHABILITY = Reachability()
OPTIONS, COSTS = ChoiceOptions(), CostWeights()
X_FG = REACHABILITY.gripper.X_FG
START = np.deg2rad([0.0, 30.0, 0.0, -60.0, 0.0, 90.0, 0.0])
#: Round the robot's base, as the paper's circle.
CIRCLE = HarmonicMotion(
    center=np.array([0.0, 0.0, 0.2]),
    amplitude=np.array([0.45, 0.45, 0.0]),
    harmonic=np.ones(3),
    offset_deg=np.array([90.0, 0.0, 0.0]),
    rate=0.3,
    start_phase=0.0,
    spin_axis=np.array([0.0, 0.0, 1.0]),
    spin=0.3,
)


def ring_of_grasps(tilts=(0.0, 0.5), turns=3):
    """Grasps from above and from inclined directions, at the object's origin, flips included."""
    poses = []
    for tilt in tilts:
        for turn in np.linspace(0.0, np.pi, turns, endpoint=False):
            R = se3.so3_exp([0.0, 0.0, turn]) @ se3.so3_exp([np.pi + tilt, 0.0, 0.0])
            poses.append(se3.make_pose(R, np.zeros(3)))
    n = len(poses)
    return GraspSet(np.array(poses), np.full(n, 0.05), np.ones(n)).with_symmetric().X_OG


GRASPS = ring_of_grasps()


def ahead(motion, t, options=OPTIONS, interception_time=0.0):
    return np.array([motion.pose(t + s) for s in options.costs.instants_from(t, interception_time)])


def choose(choice, t, q, X_OG=GRASPS, motion=CIRCLE, options=OPTIONS, *, committed=False):
    grasps = GraspSet(X_OG, np.full(len(X_OG), 0.05), np.ones(len(X_OG)))
    rates, poses = (
        options.costs.grasp_rates(grasps),
        ahead(motion, t, options, choice.interception_time),
    )
    ways = choice, t, q, X_OG, rates, poses, REACHABILITY, options
    return choose_grasp(*ways, committed=committed)


def run(duration, motion=CIRCLE, period=0.2, dt=0.02):
    """Follows the choice kinematically; times, configurations, choices and hand distances."""
    choice, q, rows = GraspChoice(), START.copy(), []
    for k in range(round(duration / dt)):
        t = k * dt
        if k % round(period / dt) == 0:
            choice = choose(choice, t, q, motion=motion)
        X_WO, V_WO, _ = motion.state(t)
        reference = candidate_reference(choice, t, q, X_WO, V_WO, REACHABILITY, OPTIONS)
        qd = pursuit_velocity(q, reference, X_WO, V_WO, X_FG, PursuitOptions())
        limit = IIWA_7.position_limits - 0.01
        q = np.clip(q + dt * qd, -limit, limit)
        p_WH = forward_kinematics(q, X_FG)[:3, 3]
        rows.append((t, q.copy(), choice, np.linalg.norm(p_WH - X_WO[:3, 3])))
    return rows


@pytest.fixture(scope="module")
def lap():
    return run(2.0 * np.pi / 0.3)


def test_the_order_of_the_grasps_does_not_matter():
    # Grasps with different offsets, so that no two are equally good.
    X_OG = GRASPS.copy()
    X_OG[:, :3, 3] = np.random.default_rng(0).uniform(-0.02, 0.02, (len(X_OG), 3))
    order = np.random.default_rng(1).permutation(len(X_OG))
    first, second = (
        choose(GraspChoice(), 0.0, START, X_OG),
        choose(GraspChoice(), 0.0, START, X_OG[order]),
    )
    np.testing.assert_array_equal(first.X_OG, second.X_OG)
    assert (first.branch, first.psi, first.interception_time) == (
        second.branch,
        second.psi,
        second.interception_time,
    )
    again = [choose(c, 0.4, START, x) for c, x in ((first, X_OG), (second, X_OG[order]))]
    np.testing.assert_array_equal(again[0].X_OG, again[1].X_OG)
    assert again[0].branch == again[1].branch


def test_the_plan_arrives_in_time_at_an_admissible_configuration():
    choice = choose(GraspChoice(), 0.0, START)
    X_WO = CIRCLE.pose(choice.interception_time)
    X_WF = X_WO @ choice.X_OG @ np.linalg.inv(X_FG)
    q = closed_form(X_WF, choice.psi)[choice.branch]
    assert REACHABILITY.admissible(q)[0]
    assert np.max(np.abs(q - START) / IIWA_7.velocity_limits) <= choice.interception_time


def test_a_grasp_behind_which_there_is_no_room_to_line_up_costs_more():
    """Near the arm's base a limit is often in the way of a hand that stands back."""
    rng, weighted = np.random.default_rng(3), ChoiceOptions(CostWeights.to_grasp_soon())
    free = ChoiceOptions(replace(weighted.costs, no_corridor=0.0))
    room = {"free": [], "priced": []}
    for _ in range(100):
        p = rng.uniform([0.2, -0.4, 0.2], [0.5, 0.4, 0.8])
        X_WO = se3.make_pose(se3.so3_exp(rng.normal(0.0, 1.0, 3)), p)
        poses = np.repeat(X_WO[None], len(COSTS.times), axis=0)
        for name, options in (("free", free), ("priced", weighted)):
            choice = choose_grasp(
                *(GraspChoice(), 0.0, START, GRASPS, np.zeros(len(GRASPS)), poses),
                *(REACHABILITY, options),
            )
            if choice:
                room[name].append(room_behind(choice, X_WO))
    least = {name: np.mean(np.array(back) < 0.06) for name, back in room.items()}
    assert len(room["free"]) == len(room["priced"]) > 50
    assert least["priced"] < 0.3 * least["free"]


def room_behind(choice, X_WO):
    """The largest distance up to 10 cm that the hand can stand back from a choice [m]."""
    X_OG = np.repeat(choice.X_OG[None], 11, axis=0)
    X_OG[:, :3, 3] -= np.linspace(0.0, 0.1, 11)[:, None] * choice.X_OG[:3, 2]
    q = closed_form(X_WO @ X_OG @ np.linalg.inv(X_FG), choice.psi)[:, choice.branch]
    inside = np.all(np.abs(q) < IIWA_7.position_limits, axis=1)  # NaN is not
    return 0.01 * (np.argmin(inside) - 1) if not inside.all() else 0.1


def from_the_side(yaw_deg):
    """A grasp at the object's origin with a level approach direction."""
    yaw = np.deg2rad(yaw_deg)
    approach, up = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([0.0, 0.0, 1.0])
    return se3.make_pose(np.column_stack([np.cross(up, approach), up, approach]), np.zeros(3))


@pytest.mark.parametrize("seed", range(4))
def test_a_hand_that_is_to_grasp_soon_does_not_wait_for_what_lasts_longer(seed):
    """An object turns: the grasp that can be had now is gone in 5 s, another can be had by then."""
    turning = HarmonicMotion(
        **vars_of(CIRCLE)
        | {"center": np.array([0.5, 0.0, 0.35]), "amplitude": np.zeros(3), "spin": 0.2}
    )
    now, later = from_the_side(75.0), from_the_side(-170.0)
    for t, expected in ((0.0, (1, 0)), (3.0, (1, 0)), (5.0, (0, 1)), (9.0, (0, 1))):
        poses = turning.pose(t) @ np.array([now, later])
        np.testing.assert_array_equal(REACHABILITY.reachable(poses), expected)
    q = START + np.random.default_rng(seed).uniform(-0.1, 0.1, 7)
    X_OG = GraspSet(np.array([now, later]), np.full(2, 0.05), np.ones(2)).with_symmetric().X_OG

    patient = choose(GraspChoice(), 0.0, q, X_OG, turning)
    assert patient.interception_time > 3.0
    np.testing.assert_allclose(patient.X_OG[:3, 2], later[:3, 2], atol=1e-12)

    options = ChoiceOptions(CostWeights.to_grasp_soon())
    soon = choose(GraspChoice(), 0.0, q, X_OG, turning, options)
    assert soon.interception_time <= 2.0 < options.costs.times[-1]
    np.testing.assert_allclose(soon.X_OG[:3, 2], now[:3, 2], atol=1e-12)


def test_a_hand_that_has_committed_keeps_its_strand_even_where_it_ends():
    """One that may change goes for the next grasp before the object has turned the first away."""
    turning = HarmonicMotion(
        **vars_of(CIRCLE)
        | {"center": np.array([0.5, 0.0, 0.35]), "amplitude": np.zeros(3), "spin": 0.2}
    )
    X_OG = np.array([from_the_side(75.0), from_the_side(-170.0)])
    options = ChoiceOptions(CostWeights.to_grasp_soon())
    first = choose(GraspChoice(), 0.0, START, X_OG, turning, options)
    np.testing.assert_array_equal(first.X_OG, X_OG[0])
    free, committed, changed = first, first, []
    for t in np.arange(0.1, 6.0, 0.1):
        X_WF = turning.pose(t) @ committed.X_OG @ np.linalg.inv(X_FG)
        q = closed_form(X_WF, committed.psi)[committed.branch]
        if np.isnan(q).any():
            q = START
        free = choose(free, t, q, X_OG, turning, options)
        committed = choose(committed, t, q, X_OG[:1], turning, options, committed=True)
        changed.append(free.count > first.count)
        assert committed
        assert (committed.count, committed.branch) == (first.count, first.branch)
        np.testing.assert_array_equal(committed.X_OG, X_OG[0])
    assert changed[-1] and not changed[0]
    assert not REACHABILITY.reachable(turning.pose(t) @ X_OG[:1]).any()


def test_a_hand_that_has_committed_to_another_grasp_than_it_went_for_stays_where_it_is():
    still = HarmonicMotion(**vars_of(CIRCLE) | {"rate": 0.0, "spin": 0.0})
    wanted = choose(GraspChoice(), 0.0, START, motion=still)
    X_WO = still.pose(0.0)
    others = 0
    for X_OG in GRASPS:
        for branch, q in enumerate(closed_form(X_WO @ X_OG @ np.linalg.inv(X_FG), 0.3)):
            if not REACHABILITY.admissible(q)[0]:
                continue
            held = choose(wanted, 0.1, q, X_OG[None], still, committed=True)
            np.testing.assert_array_equal(held.X_OG, X_OG)
            assert held.branch == branch and held.count == wanted.count
            reference = candidate_reference(held, 0.1, q, X_WO, np.zeros(6), REACHABILITY, OPTIONS)
            np.testing.assert_allclose(reference.X_OT, X_OG, atol=1e-9)
            assert reference.on_candidate
            others += branch != wanted.branch
    assert others > 3


def test_without_grasps_or_poses_there_is_no_choice():
    assert not GraspChoice()
    assert not choose(GraspChoice(), 0.0, START, np.zeros((0, 4, 4)))
    far = HarmonicMotion(**{**vars_of(CIRCLE), "center": np.array([3.0, 0.0, 0.2])})
    assert not choose(GraspChoice(), 0.0, START, motion=far)
    lost = np.full((len(COSTS.instants), 4, 4), np.nan)
    present = choose(GraspChoice(), 0.0, START)
    free = np.zeros(len(GRASPS))
    assert not choose_grasp(present, 0.1, START, GRASPS, free, lost, REACHABILITY, OPTIONS)


def vars_of(motion):
    return {name: getattr(motion, name) for name in motion.__dataclass_fields__}


def test_no_choice_has_no_reference_and_lost_poses_have_none():
    X_WO, V_WO, _ = CIRCLE.state(0.0)
    assert candidate_reference(GraspChoice(), 0, START, X_WO, V_WO, REACHABILITY, OPTIONS) is None
    choice = choose(GraspChoice(), 0.0, START)
    lost = np.full((4, 4), np.nan)
    assert candidate_reference(choice, 0, START, lost, V_WO, REACHABILITY, OPTIONS) is None


def test_the_circle_is_followed_with_few_changes_and_unwound_before_the_limit(lap):
    distance = np.array([row[3] for row in lap])
    q = np.array([row[1] for row in lap])
    changes = lap[-1][2].count
    # Grasps at the object's middle: what is left are the ways between grasps.
    assert np.mean(distance) < 0.12
    assert np.mean(distance[100:] < 0.005) > 0.6
    assert 2 <= changes <= 20
    # Stopped at the limit of joint 1 the hand would stay behind by up to twice the radius, for
    # half a lap; it never stands there with the object leaving.
    stuck = (np.abs(q[:, 0]) > IIWA_7.position_limits[0] - 0.02) & (distance > 0.1)
    assert np.mean(stuck) < 0.02


def test_a_choice_is_kept_for_a_while_and_not_taken_back_at_once(lap):
    choices = [lap[0][2]]
    for _, _, choice, _ in lap:
        if choice.count != choices[-1].count:
            choices.append(choice)
    times = np.array([choice.since for choice in choices])
    assert np.all(np.diff(times) >= OPTIONS.hysteresis - 1e-9)
    for a, b in zip(choices[:-2], choices[2:], strict=True):
        back = a.branch == b.branch and np.allclose(a.X_OG, b.X_OG)
        assert not (back and b.since - a.since < 1.0)


def test_the_reference_follows_the_grasp_exactly_once_there():
    choice = choose(GraspChoice(), 0.0, START)
    t = choice.interception_time
    X_WO, V_WO, _ = CIRCLE.state(t)
    X_WF = X_WO @ choice.X_OG @ np.linalg.inv(X_FG)
    q = closed_form(X_WF, choice.psi)[choice.branch]
    reference = candidate_reference(choice, t, q, X_WO, V_WO, REACHABILITY, OPTIONS)
    assert reference.on_candidate
    np.testing.assert_allclose(reference.q, q, atol=1e-9)
    np.testing.assert_allclose(reference.X_OT, choice.X_OG, atol=1e-9)
    # Its velocity carries the hand along with the object.
    dt = 1e-5
    moved = forward_kinematics(q + dt * reference.qd, X_FG)
    expected = CIRCLE.pose(t + dt) @ choice.X_OG
    assert np.linalg.norm((moved - expected)[:3, 3]) < 0.02 * dt
    assert se3.rotation_angle(moved[:3, :3].T @ expected[:3, :3]) < 0.05 * dt
    assert arm_angle(q) == pytest.approx(choice.psi)


def test_pursuit_is_inside_the_speed_limits_and_leaves_the_slow_joint_its_speed():
    rng = np.random.default_rng(4)
    X_WO, V_WO, _ = CIRCLE.state(1.0)
    choice = choose(GraspChoice(), 1.0, START)
    for _ in range(50):
        q = rng.uniform(-0.9, 0.9, 7) * IIWA_7.position_limits
        reference = candidate_reference(choice, 1.0, q, X_WO, V_WO, REACHABILITY, OPTIONS)
        options = PursuitOptions()
        qd = pursuit_velocity(q, reference, X_WO, V_WO, X_FG, options)
        assert np.all(np.abs(qd) <= IIWA_7.velocity_limits + 1e-12)
        needed = np.abs(reference.q - q) / IIWA_7.velocity_limits
        slow = int(np.argmax(needed))
        if needed[slow] > 1.0:
            towards = qd[slow] * np.sign(reference.q[slow] - q[slow]) / IIWA_7.velocity_limits[slow]
            assert towards > 0.5 * options.speed_share


def test_what_is_due_stays_due_from_plan_to_plan():
    """An arm that is on its way in time is not given more."""
    options = replace(OPTIONS, costs=replace(COSTS, regrip_time=0.0))
    first = choice = choose(GraspChoice(), 0.0, START, options=options)
    X_WF = CIRCLE.pose(first.interception_time) @ first.X_OG @ np.linalg.inv(X_FG)
    goal = closed_form(X_WF, first.psi)[first.branch]
    for t in np.arange(0.07, 0.95 * first.interception_time, 0.07):
        choice = choose(
            choice, t, START + t / first.interception_time * (goal - START), options=options
        )
        assert choice.count == first.count and choice.interception_time == pytest.approx(
            first.interception_time
        )


@pytest.mark.parametrize("costs", [COSTS, CostWeights.to_grasp_soon()])
def test_what_is_due_is_an_instant_of_every_plan_before(costs):
    rng, step = np.random.default_rng(0), costs.times[1]
    for start, left in rng.uniform(0.01, [9.0, costs.times[-1]], (50, 2)):
        for t in np.linspace(start, start + left, 7)[:-1]:
            times = costs.instants_from(t, start + left)
            assert times[0] == 0.0 and (np.diff(times) > 0.0).all()
            at = instant_at(start + left - t, times)
            assert t + times[at] == pytest.approx(start + left)
            rounds = (t + np.delete(times[1:], at - 1)) / step  # the others are on the grid
            np.testing.assert_allclose(rounds, np.round(rounds), atol=1e-9)
        after = costs.instants_from(start + 2.0 * left, start + left)
        np.testing.assert_array_equal(after, costs.instants_from(start + 2.0 * left, 0.0))


def test_another_way_of_holding_has_to_be_better_by_the_commitment():
    """An arm that is where one of the ways wants it: changed if the costs differ by more."""
    rng, changed, better = np.random.default_rng(0), [], []
    several = [replace(OPTIONS, commitment=price) for price in (0.0, 1.0, np.inf)]
    for X_OG in GRASPS[:4]:
        ways = closed_form(CIRCLE.pose(0.0) @ X_OG @ np.linalg.inv(X_FG), rng.uniform(-1.0, 1.0))
        for branch in np.flatnonzero(np.isfinite(ways).all(axis=1)):
            q = ways[branch]
            there = GraspChoice(X_OG, int(branch), arm_angle(q), interception_time=-1.0, since=-9.0)
            free, usual, stays = [choose(there, 0.0, q, options=each) for each in several]
            if stays.count == 0:  # it can be held so
                changed.append(usual.count)
                better.append(stays.cost - free.cost)
    np.testing.assert_array_equal(changed, np.array(better) > 1.0)
    assert 0 < np.sum(changed) < np.sum(np.array(better) > 0.0) <= len(changed)
