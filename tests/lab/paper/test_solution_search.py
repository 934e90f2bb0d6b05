"""Updates of the solutions: identity is kept, nothing that counts jumps, and sources agree."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import branch_kernel, flange_pose_kernel, solve_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.paper.solutions import (
    COST_RATE,
    IRRELEVANT,
    Solutions,
    SolutionSearch,
    matches,
)
from feasigrasp_lab.paper.sources import APART

REACHABILITY = Reachability()
X_FG = REACHABILITY.gripper.X_FG
HOME = np.deg2rad([0, -48.5, 0, -90.6, 0, 82.9, 0])
PERIOD = 0.05
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])


def search(**options):
    return SolutionSearch(REACHABILITY, PaperOptions(**options), PERIOD)


def reachable(grasps, X_WO=X_WO):
    X_OG = grasps.with_symmetric().X_OG
    return X_OG[REACHABILITY.reachable(X_WO @ X_OG)]


def configurations(solutions, X_WO):
    q, X_WF, X_GF = np.empty((len(solutions), 7)), np.empty((4, 4)), se3.inverse(X_FG)
    for k in range(len(q)):
        flange_pose_kernel(X_WO, solutions.X_OG[k], 0.0, X_GF, X_WF)
        assert solve_kernel(IIWA_7.chain, X_WF, solutions.branch[k], solutions.arm_angle[k], q[k])
    return q


@pytest.mark.parametrize("source", ["closed_form", "flow"])
def test_solutions_reach_their_grasps_and_are_admissible(ring_of_grasps, source):
    X_OG = reachable(ring_of_grasps)
    found = search(source=source).update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
    q = configurations(found, X_WO)
    assert len(found) > 10
    assert (matches(found.X_OG, X_OG) >= 0).all()
    assert REACHABILITY.admissible(q).all()
    np.testing.assert_array_equal([branch_kernel(IIWA_7.chain, one) for one in q], found.branch)
    np.testing.assert_allclose(forward_kinematics(q, X_FG), X_WO @ found.X_OG, atol=2e-3)
    # Those of one grasp are apart.
    for X in X_OG[:5]:
        mine = q[matches(found.X_OG, X[None]) == 0]
        r = np.linalg.norm(mine[:, None] - mine, axis=2)[np.triu_indices(len(mine), 1)]
        assert (r > APART - 1e-6).all()


def test_what_the_flow_reaches_the_closed_form_reaches(ring_of_grasps):
    """Every grasp of the flow is one of its; and most of its are the flow's, which only draws."""
    X_OG = reachable(ring_of_grasps)
    whole, drawn = (
        search(source=each, n_solutions=200).update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
        for each in ("closed_form", "flow")
    )
    of_whole, of_drawn = (set(matches(found.X_OG, X_OG)) for found in (whole, drawn))
    assert of_drawn <= of_whole == set(range(len(X_OG)))
    assert len(of_drawn) > 0.7 * len(of_whole)


def test_the_best_solution_of_every_grasp_comes_before_the_second_of_any(ring_of_grasps):
    X_OG = reachable(ring_of_grasps)
    found = search(n_solutions=len(X_OG)).update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
    assert sorted(matches(found.X_OG, X_OG)) == list(range(len(X_OG)))
    few = search(n_solutions=5).update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
    assert len(few) == 5


def test_matching_keeps_identity_while_the_object_moves(ring_of_grasps):
    """Grasp, branch and arm angle stay through updates in any order."""
    rng = np.random.default_rng(0)
    X_OG, V = reachable(ring_of_grasps), np.array([0.1, -0.1, 0.1, 0.05, 0.1, 0.0])
    keep = search(n_solutions=400)
    first = keep.update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
    solutions, before, followed = first, configurations(first, X_WO), 0
    for k in range(1, 6):
        moved = se3.extrapolate(X_WO, V, k * PERIOD)
        solutions = keep.update(solutions, k * PERIOD, rng.permutation(X_OG), moved, HOME)
        q = configurations(solutions, moved)
        for X, branch, angle, was in zip(
            first.X_OG, first.branch, first.arm_angle, before, strict=True
        ):
            same = (matches(solutions.X_OG, X[None]) == 0) & (solutions.branch == branch)
            same &= solutions.arm_angle == angle
            if same.any():
                followed += 1
                np.testing.assert_allclose(q[same][0], was, atol=0.1)
        before = moved_configurations(first, moved)
    assert followed > 0.9 * 5 * len(first)


def moved_configurations(solutions, X_WO):
    """As `configurations`; NaN where the object is out of reach by now."""
    q, X_WF, X_GF = np.full((len(solutions), 7), np.nan), np.empty((4, 4)), se3.inverse(X_FG)
    for k in range(len(q)):
        flange_pose_kernel(X_WO, solutions.X_OG[k], 0.0, X_GF, X_WF)
        solve_kernel(IIWA_7.chain, X_WF, solutions.branch[k], solutions.arm_angle[k], q[k])
    return q


def test_nothing_that_counts_appears_or_vanishes_at_an_update(ring_of_grasps):
    """Just before and just after an update the solutions that count have the same cost."""
    rng = np.random.default_rng(1)
    X_OG, keep = reachable(ring_of_grasps), search(n_solutions=20)
    solutions, q = (
        keep.update(Solutions.empty(), 0.0, X_OG[:10], X_WO, HOME),
        HOME.copy(),
    )
    for k in range(1, 20):
        offered = X_OG[rng.random(len(X_OG)) < 0.5]
        time, moved = k * PERIOD, se3.extrapolate(X_WO, np.full(6, 0.1), k * PERIOD)
        after = keep.update(solutions, time, offered, moved, q)
        if len(after) == 0:
            continue
        cost, scale = solutions.at(PERIOD)
        q_before = configurations(solutions, moved)
        score = np.linalg.norm(q_before - q, axis=1) + cost
        relevant = np.min(score) + (IRRELEVANT - 1e-6) * scale
        for i in np.flatnonzero(score < relevant):
            same = matches(after.X_OG, solutions.X_OG[i][None]) == 0
            same &= after.arm_angle == solutions.arm_angle[i]
            assert same.any() and np.abs(after.cost[same, 0] - cost[i]).min() < 1e-9
        # And those that are new count nothing yet.
        q_after = configurations(after, moved)
        for j in range(len(after)):
            same = matches(solutions.X_OG, after.X_OG[j][None]) == 0
            if not (same & (solutions.arm_angle == after.arm_angle[j])).any():
                assert np.linalg.norm(q_after[j] - q) + after.cost[j, 0] > relevant - 1e-6
        np.testing.assert_allclose(after.at(0.0)[1], scale)
        assert (np.abs(after.cost[:, 1]) <= COST_RATE + 1e-12).all()
        solutions, q = after, q + 0.02 * rng.normal(size=7)


def test_a_grasp_that_is_gone_rises_in_cost_until_it_is_left_out(ring_of_grasps):
    X_OG, keep = reachable(ring_of_grasps)[:6], search()
    solutions = keep.update(Solutions.empty(), 0.0, X_OG, X_WO, HOME)
    nearest = configurations(solutions, X_WO)
    q = nearest[0]
    lost = matches(solutions.X_OG[:1], X_OG)[0]
    rest = np.delete(X_OG, lost, axis=0)
    costs = []
    for k in range(1, 60):
        solutions = keep.update(solutions, k * PERIOD, rest, X_WO, q)
        mine = matches(solutions.X_OG, X_OG[[lost]]) == 0
        if not mine.any():
            break
        costs.append(solutions.cost[mine, 0].min())
    assert 1 < len(costs) < 59
    np.testing.assert_allclose(np.diff(costs), COST_RATE * PERIOD, atol=1e-9)


def test_without_grasps_there_are_no_solutions():
    nothing = search().update(Solutions.empty(), 0.3, np.zeros((0, 4, 4)), X_WO, HOME)
    assert len(nothing) == 0 and nothing.time == 0.3


def test_grasps_out_of_reach_have_none(ring_of_grasps):
    far = se3.make_pose(np.eye(3), [2.0, 0.0, 0.5])
    keep = search()
    assert len(keep.update(Solutions.empty(), 0.0, ring_of_grasps.X_OG, far, HOME)) == 0
    some = keep.update(Solutions.empty(), 0.0, reachable(ring_of_grasps), X_WO, HOME)
    assert len(keep.update(some, PERIOD, ring_of_grasps.X_OG, far, HOME)) == 0


def test_random_configurations_and_objects_give_finite_solutions(ring_of_grasps):
    rng, keep = np.random.default_rng(2), search()
    solutions = Solutions.empty()
    for k in range(30):
        X = se3.random_pose(rng, 1)[0]
        X[:3, 3] = rng.uniform(-0.8, 0.8, 3)
        q = rng.uniform(-1, 1, 7) * IIWA_7.upper
        offered = ring_of_grasps.X_OG[rng.random(len(ring_of_grasps)) < rng.random()]
        solutions = keep.update(solutions, k * PERIOD, offered, X, q)
        for array in (solutions.arm_angle, solutions.cost, solutions.length_scale):
            assert np.isfinite(array).all()
