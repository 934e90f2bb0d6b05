"""Least times against the set of reachable ways; interceptions against forward kinematics."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import branch_kernel, redundancy_kernel
from feasigrasp.models.objects.prediction import PredictionModel
from feasigrasp.models.reach.interception import (
    InterceptionOptions,
    Situation,
    find_interceptions,
    least_time_kernel,
)
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

OPTIONS = InterceptionOptions()
Q = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1])
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
STILL = np.zeros(6)


@pytest.fixture(scope="module")
def reachability():
    return Reachability()


def interceptions(
    reachability,
    X_OG,
    V_WO=STILL,
    *,
    X_WO=X_WO,
    score=1.0,
    present=None,
    lift=OPTIONS.lift,
    **motion,
):
    """Interceptions of grasps of one score by an arm at Q, at rest."""
    now, options = Situation(0.0, Q, np.zeros(7), X_WO, V_WO, **motion), replace(OPTIONS, lift=lift)
    return find_interceptions(X_OG, np.full(len(X_OG), score), now, reachability, options, present)


def grasp_at(reachability, q):
    return (se3.inverse(X_WO) @ forward_kinematics(q, reachability.gripper.X_FG))[None]


@pytest.mark.parametrize("seed", range(20))
def test_least_time_is_the_first_at_which_the_way_is_possible(seed):
    """In a time T the ways lie between those of the lowest and the highest speed profile."""
    rng = np.random.default_rng(seed)
    speed, acceleration = rng.uniform(0.5, 2.0), rng.uniform(1.0, 10.0)
    v_0, v_1 = rng.uniform(-speed, speed, 2)
    way = rng.uniform(-2.0, 2.0)

    def possible(T):
        t = np.linspace(0.0, T, 4001)
        high = np.minimum(np.minimum(v_0 + acceleration * t, v_1 + acceleration * (T - t)), speed)
        low = np.maximum(np.maximum(v_0 - acceleration * t, v_1 - acceleration * (T - t)), -speed)
        # The profile has to end at the other velocity as well.
        ends = abs(v_1 - v_0) <= acceleration * T
        return ends and np.trapezoid(low, t) - 1e-6 <= way <= np.trapezoid(high, t) + 1e-6

    least = least_time_kernel(way, v_0, v_1, speed, acceleration)
    assert possible(least + 1e-4)
    assert not possible(least - 1e-3)


def test_a_resting_grasp_is_intercepted_where_it_is(reachability):
    X_OG = grasp_at(reachability, Q + 0.2)
    found = interceptions(reachability, X_OG)
    X_WG = forward_kinematics(found.q[0], reachability.gripper.X_FG)
    np.testing.assert_allclose(X_WG, X_WO @ X_OG[0], atol=1e-6)
    assert reachability.admissible(found.q)[0]
    assert found.cost[0] == found.arrival[0]  # nothing is missing, nothing is hard
    speed, acceleration = 0.9 * IIWA_7.velocity_limits, 0.95 * IIWA_7.acceleration_limits
    least = max(map(least_time_kernel, found.q[0] - Q, 0.0 * Q, 0.0 * Q, speed, acceleration))
    assert least <= found.arrival[0] + 0.04
    assert found.arrival[0] < least + 2.0 * OPTIONS.step


@pytest.mark.parametrize("rise", np.linspace(0.0, 0.6, 7))
def test_what_cannot_be_lifted_lacks_a_second(reachability, rise):
    """At its branch and arm angle, judged by the closed form of any."""
    X_OG, lift = grasp_at(reachability, Q + 0.2), (0.0, 0.0, rise)
    present = branch_kernel(IIWA_7.chain, Q + 0.2), redundancy_kernel(IIWA_7.chain, Q + 0.2)
    kept = interceptions(reachability, X_OG, present=present)
    found = interceptions(reachability, X_OG, present=present, lift=lift)
    up = se3.make_pose(np.eye(3), lift) @ X_WO @ X_OG
    _, times = reachability.nearest(up, Q + 0.2)
    lacks = found.cost[0] - kept.cost[0]
    assert lacks == pytest.approx(0.0) or lacks == pytest.approx(OPTIONS.lack)
    if lacks == 0.0:  # then there is a configuration up there
        assert np.isfinite(times[0])
    assert (rise > 0.0) or lacks == 0.0
    assert (rise < 0.6) or lacks > 0.0


@pytest.mark.parametrize("w", [0.5, -1.5])
def test_a_grasp_that_turns_is_intercepted_on_its_path(reachability, w):
    """In position, and in velocity: that of the solution there over the next step."""
    X_OG, V_WO = grasp_at(reachability, Q + 0.2), np.array([0.0, 0.0, w, 0.0, 0.0, 0.0])
    found = interceptions(reachability, X_OG, V_WO)
    for ahead in (0.0, OPTIONS.step):
        X_WG = forward_kinematics(found.q[0] + ahead * found.v[0], reachability.gripper.X_FG)
        there = se3.extrapolate(X_WO, V_WO, found.arrival[0] + ahead) @ X_OG[0]
        np.testing.assert_allclose(X_WG, there, atol=1e-6)
    assert np.abs(found.v[0]).max() > 0.2


def test_the_prediction_decides_where_the_object_will_be(reachability):
    X_OG, V_WO = grasp_at(reachability, Q + 0.2), np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    stays = interceptions(reachability, X_OG, V_WO, prediction=PredictionModel.NONE)
    rests = interceptions(reachability, X_OG)
    np.testing.assert_array_equal(stays.q, rests.q)
    np.testing.assert_array_equal(stays.cost, rests.cost)


def test_a_factor_of_e_in_score_is_worth_its_time(reachability):
    X_OG = grasp_at(reachability, Q + 0.2)
    best = interceptions(reachability, X_OG)
    worse = interceptions(reachability, X_OG, score=np.exp(-1.0))
    assert worse.cost[0] - best.cost[0] == pytest.approx(OPTIONS.score, abs=1e-12)
    assert worse.arrival[0] == best.arrival[0]


def test_a_present_configuration_is_kept_where_it_is_asked_for(reachability):
    X_OG = grasp_at(reachability, Q)
    both = np.concatenate([X_OG, X_OG])
    free = interceptions(reachability, both)
    other = float(free.psi[0]) + 0.3
    bound = interceptions(reachability, both, present=(int(free.branch[0]), other))
    assert bound.psi[0] == free.psi[0]
    assert bound.psi[1] == other
    assert bound.cost[1] > bound.cost[0]


def test_faster_objects_cost_more_until_none_can_be_followed(reachability):
    X_OG = grasp_at(reachability, Q)
    costs = [
        interceptions(reachability, X_OG, np.array([0.0, 0.0, w, 0.0, 0.0, 0.0])).cost[0]
        for w in (0.0, 1.0, 20.0)
    ]
    assert costs[0] < costs[1] < costs[2]
    assert costs[2] == np.inf


def test_a_grasp_that_goes_into_the_table_is_followed_until_there():
    """The finger tips are above the table when it is met, and in it within a second."""
    looking_down = se3.make_pose(se3.so3_exp([np.pi, 0.0, 0.0]), [0.5, 0.0, 0.30])
    sinking = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -0.15])
    now = Situation(0.0, IIWA_7.home, np.zeros(7), looking_down, sinking)
    cost = [
        find_interceptions(
            np.eye(4)[None], np.ones(1), now, Reachability(table_height=height), OPTIONS
        ).cost[0]
        for height in (0.0, -5.0)
    ]
    assert cost[1] + 0.5 < cost[0] < np.inf


def test_out_of_reach_there_is_none(reachability):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    found = interceptions(reachability, np.eye(4)[None], X_WO=far)
    assert found.cost[0] == found.arrival[0] == np.inf


def test_instants_do_not_recede():
    """At any time they are multiples of the step, the first one less than a step ahead."""
    for now in (0.0, 0.01, 0.124, 7.3):
        times = now + OPTIONS.times(now)
        np.testing.assert_allclose(times / OPTIONS.step, np.round(times / OPTIONS.step), atol=1e-6)
        assert now - 1e-9 <= times[0] < now + OPTIONS.step
