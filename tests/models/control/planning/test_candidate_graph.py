"""CandidateGraph: their nodes, what follows, and what it costs to keep to one arm angle."""

import dataclasses

import numpy as np
import pytest

from feasigrasp.models.control.planning.branch_switches import path_cost_kernel
from feasigrasp.models.control.planning.candidate_graph import (
    candidate_cost_kernel,
    candidate_graph_kernel,
)
from feasigrasp.models.control.planning.cost_weights import (
    CostWeights,
    running_cost_kernel,
    terminal_cost_kernel,
)
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability

REACHABILITY = Reachability()
COSTS = CostWeights()
X_FG = REACHABILITY.gripper.X_FG
START = np.deg2rad([0.0, 30.0, 0.0, -60.0, 0.0, 90.0, 0.0])


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
FREE = np.zeros(len(GRASPS))


def test_the_nodes_of_all_strands_are_admissible_and_reach_their_grasps():
    """Round the robot's base, as the paper's circle."""
    motion = HarmonicMotion(
        center=np.array([0.0, 0.0, 0.2]),
        amplitude=np.array([0.45, 0.45, 0.0]),
        harmonic=np.ones(3),
        offset_deg=np.array([90.0, 0.0, 0.0]),
        rate=0.3,
        start_phase=0.0,
        spin_axis=np.array([0.0, 0.0, 1.0]),
        spin=0.3,
    )
    poses = np.array([motion.pose(1.0 + t) for t in COSTS.times])
    X_GF = np.linalg.inv(X_FG)
    graph = candidate_graph_kernel(
        START, poses, COSTS.instants, GRASPS, FREE, X_GF, REACHABILITY.search, COSTS.record
    )
    k, i, branch, angle = np.nonzero(np.isfinite(graph.rate))
    q = graph.q[k, i, branch, angle]
    assert len(q) > 300
    assert REACHABILITY.admissible(q).all()
    np.testing.assert_allclose(forward_kinematics(q, X_FG), poses[k] @ GRASPS[i], atol=1e-9)
    signs = 4 * (q[:, 3] < 0.0) + 2 * (q[:, 1] < 0.0) + (q[:, 5] < 0.0)
    np.testing.assert_array_equal(signs, branch)
    # What follows can be reached in time, and leads to the end of the strand without a gap.
    successor = graph.successor[k, i, branch, angle]
    go_on = successor >= 0
    later = graph.q[k[go_on] + 1, i[go_on], branch[go_on], successor[go_on]]
    steps = np.diff(COSTS.instants)[k[go_on]]
    travel = np.max(np.abs(later - q[go_on]) / IIWA_7.velocity_limits, axis=1)
    assert np.all(travel <= COSTS.follow_share * steps + 1e-12)


@pytest.mark.parametrize(("share", "followed"), [(0.85, True), (0.95, False)])
def test_a_grasp_is_followed_as_fast_as_the_safety_problem_allows(share, followed):
    """The object turns about the hand's axis, so that only the last joint moves."""
    X_WG, spin = forward_kinematics(START, X_FG), share * IIWA_7.velocity_limits[6]
    times = np.linspace(0.0, 0.5, 3)
    poses = np.array([X_WG @ se3.exp([0.0, 0.0, spin * t, 0.0, 0.0, 0.0]) for t in times])
    X_GF, still = np.linalg.inv(X_FG), np.eye(4)[None]
    graph = candidate_graph_kernel(
        START, poses, times, still, FREE[:1], X_GF, REACHABILITY.search, COSTS.record
    )
    kept = graph.successor[0, 0] == np.arange(graph.successor.shape[-1])
    assert kept.any() == followed
    assert (share < SafetyOptions.velocity_scale) == followed


def test_an_arm_angle_that_is_kept_costs_no_less_than_the_best_way_through_the_arm_angles():
    """The joint-space controller's cost of a strand beside the table's, where both see the same."""
    still = dataclasses.replace(COSTS, times=tuple(np.linspace(0.0, 1.5, 9)), motion=0.0)
    poses = np.repeat(se3.make_pose(np.eye(3), [0.5, 0.0, 0.3])[None], len(still.times), axis=0)
    X_GF, search, checked = np.linalg.inv(X_FG), REACHABILITY.search, 0
    own = np.linspace(0.0, 1.0, len(GRASPS))
    graph = candidate_graph_kernel(
        START, poses, still.instants, GRASPS, own, X_GF, search, still.record
    )
    for i, b, j in np.argwhere(np.isfinite(graph.rate[0])):
        kept = candidate_cost_kernel(
            *(poses, still.instants, GRASPS[i], own[i], 0.0, X_GF, b, search.psis[j], search),
            *(still.record[0], np.empty((4, 4)), np.empty(7)),
        )
        # The table also asks where the joints are going beyond the horizon: nowhere, here.
        end = still.end * (1.0 - 1.5 / still.expiry_horizon)
        assert kept == pytest.approx(1.5 * graph.rate[0, i, b, j] + end, rel=1e-6)
        assert graph.cost_to_go[0, i, b, j] <= kept + 1e-9
        checked += 1
    assert checked > 50


def test_prices_are_seconds_without_the_object():
    """At the distance `lost` a second costs a second; posture comes on top."""
    costs = COSTS.record[0]
    good = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.0, 0.0])
    lack = max(0.0, 1.0 - manipulability(good) / COSTS.manipulability)
    posture = COSTS.manipulability_cost * lack
    assert running_cost_kernel(good, 0.0, costs) == pytest.approx(posture)
    assert running_cost_kernel(good, 1.0, costs) == pytest.approx(1.0 + posture)
    at_limit = good.copy()
    at_limit[0] = IIWA_7.position_limits[0]
    assert running_cost_kernel(at_limit, 0.0, costs) == pytest.approx(COSTS.limit_cost + posture)
    assert terminal_cost_kernel(0.0, costs) == COSTS.end
    assert terminal_cost_kernel(2.0 * COSTS.expiry_horizon, costs) == 0.0


def test_a_way_costs_the_distance_of_the_hand_for_its_duration():
    """Of a hand that stays where it is, beside an object that stays, or leaves at 0.1 m/s."""
    X_WH = forward_kinematics(START, X_FG)
    X_WO = np.tile(X_WH, (3, 1, 1))
    X_WO[:, :3, 3] -= [0.0, 0.2, 0.0]
    times, search, costs = np.array([0.0, 1.0, 2.0]), REACHABILITY.search, COSTS.record[0]

    def cost(k, X_WO):
        return path_cost_kernel(START, START, 0, k, 2.0, X_WO, times, 0.2, 0.2, search, X_FG, costs)

    assert cost(0, X_WO) == pytest.approx(2.0 * 0.2 / COSTS.lost)
    assert cost(2, X_WO) == pytest.approx(2.0 * 0.2 / COSTS.lost)
    leaves = X_WO.copy()
    leaves[:, 1, 3] -= 0.1 * times
    mean = (0.5 * (0.2 + 0.2) + 0.25 + 0.3 + 0.35) / 4.0
    assert cost(2, leaves) == pytest.approx(2.0 * mean / COSTS.lost)
    assert cost(0, leaves) == pytest.approx(2.0 * 0.2 / COSTS.lost)
