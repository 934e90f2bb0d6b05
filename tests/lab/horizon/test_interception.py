"""Least times against the set of reachable ways; interceptions against forward kinematics."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.horizon.interception import (
    InterceptionOptions,
    find_interceptions,
    least_time_kernel,
)

OPTIONS = InterceptionOptions()
Q = np.array([0.1, 0.7, 0.1, 1.4, 0.1, -0.8, 0.1])


@pytest.fixture(scope="module")
def reachability():
    return Reachability()


def path(X_WO, twist):
    """Poses at the instants of an object that moves on with a twist."""
    return np.array([se3.extrapolate(X_WO, twist, t) for t in OPTIONS.times(0.0)])


def grasp_at(reachability, q, X_WO):
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
    q_there = Q + 0.2
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    X_OG = grasp_at(reachability, q_there, X_WO)
    found = find_interceptions(X_OG, path(X_WO, np.zeros(6)), Q, 0.0 * Q, reachability, OPTIONS)
    X_WG = forward_kinematics(found.q[0], reachability.gripper.X_FG)
    np.testing.assert_allclose(X_WG, X_WO @ X_OG[0], atol=1e-6)
    assert reachability.admissible(found.q)[0]
    assert found.cost[0] == found.arrival[0]  # nothing is missing, nothing is hard
    speed, acceleration = 0.9 * IIWA_7.velocity_limits, 0.95 * IIWA_7.acceleration_limits
    least = max(map(least_time_kernel, found.q[0] - Q, 0.0 * Q, 0.0 * Q, speed, acceleration))
    assert least <= found.arrival[0] + 0.04
    assert found.arrival[0] < least + 2.0 * OPTIONS.step


def test_a_present_configuration_is_kept_where_it_is_asked_for(reachability):
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    X_OG = grasp_at(reachability, Q, X_WO)
    both = np.concatenate([X_OG, X_OG])
    poses = path(X_WO, np.zeros(6))
    free = find_interceptions(both, poses, Q, 0.0 * Q, reachability, OPTIONS)
    other = float(free.psi[0]) + 0.3
    present = int(free.branch[0]), other
    bound = find_interceptions(both, poses, Q, 0.0 * Q, reachability, OPTIONS, 0.0, present)
    assert bound.psi[0] == free.psi[0]
    assert bound.psi[1] == other
    assert bound.cost[1] > bound.cost[0]


def test_faster_objects_cost_more_until_none_can_be_followed(reachability):
    X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
    X_OG = grasp_at(reachability, Q, X_WO)
    costs = [
        find_interceptions(
            X_OG, path(X_WO, np.array([0, 0, w, 0, 0, 0.0])), Q, 0.0 * Q, reachability, OPTIONS
        ).cost[0]
        for w in (0.0, 1.0, 20.0)
    ]
    assert costs[0] < costs[1] < costs[2]
    assert costs[2] == np.inf


def test_out_of_reach_there_is_none(reachability):
    X_WO = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    found = find_interceptions(
        np.eye(4)[None], path(X_WO, np.zeros(6)), Q, 0.0 * Q, reachability, OPTIONS
    )
    assert found.cost[0] == np.inf


def test_instants_do_not_recede():
    """At any time they are multiples of the step, the first one less than a step ahead."""
    for now in (0.0, 0.01, 0.124, 7.3):
        times = now + OPTIONS.times(now)
        np.testing.assert_allclose(times / OPTIONS.step, np.round(times / OPTIONS.step), atol=1e-6)
        assert now - 1e-9 <= times[0] < now + OPTIONS.step
