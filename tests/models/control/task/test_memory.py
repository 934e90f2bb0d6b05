"""Density and score decide which grasp is chosen, and how the hand moves."""

from dataclasses import replace

import numpy as np
import pytest

from feasigrasp.models.control.planning.cost_weights import LEAST_SCORE, RAREST, CostWeights
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.control.task.memory import TaskMemory
from feasigrasp.models.control.task.safe_law import TaskControlOptions, task_space_velocity
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import forward_kinematics

REACHABILITY = Reachability()
OPTIONS = TaskControlOptions(choice=ChoiceOptions(CostWeights.to_grasp_soon()))
SAFETY = SafetyFilter(OPTIONS.safety, REACHABILITY.gripper)
#: The arm and the object are alike on both sides of the plane y = 0.
HOME = np.deg2rad([0.0, 20.0, 0.0, -80.0, 0.0, 80.0, 0.0])
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.2])
MIRROR = np.diag([1.0, -1.0, 1.0])
STILL = np.zeros(6)


def mirrored(X_OG):
    """The grasps on the other side; the closing direction, along x, is on both."""
    other = np.tile(np.eye(4), (len(X_OG), 1, 1))
    other[:, :3, :3] = MIRROR @ X_OG[:, :3, :3] @ np.diag([1.0, -1.0, 1.0])
    other[:, :3, 3] = X_OG[:, :3, 3] @ MIRROR
    return other


def from_above(places):
    """Grasps from above, at places (n, 2) in the object's x and y."""
    down = np.column_stack([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    return np.array([se3.make_pose(down, [x, y, 0.0]) for x, y in places])


#: One grasp at either side, and more that are all farther from the middle.
SIDE = from_above([(0.0, 0.06)])
CROWD = from_above([(x, y) for x in (-0.024, -0.012, 0.012, 0.024) for y in (0.064, 0.07)])


def grasp_set(left, right, left_score=0.9, right_score=0.9):
    X_OG = np.concatenate([left, mirrored(right)])
    score = np.repeat([left_score, right_score], [len(left), len(right)])
    return GraspSet(X_OG, np.full(len(X_OG), 0.05), score)


def planned(grasps, options=OPTIONS.choice):
    ahead = np.tile(X_WO, (len(options.costs.times), 1, 1))
    memory = TaskMemory().with_grasps(grasps, 10, 0)
    return memory.with_choice(0.0, HOME, ahead, REACHABILITY, options).choice


def side(grasps, **costs):
    choice = planned(grasps, ChoiceOptions(replace(CostWeights.to_grasp_soon(), **costs)))
    assert choice
    return np.sign(choice.X_OG[1, 3])


def test_the_hand_goes_where_grasps_are_dense():
    crowd = np.concatenate([SIDE, CROWD])
    crowded_left, crowded_right = grasp_set(crowd, SIDE), grasp_set(SIDE, crowd)
    assert (side(crowded_left), side(crowded_right)) == (1.0, -1.0)
    # Without a price of density it is the same side, whichever is crowded.
    assert side(crowded_left, density=0.0) == side(crowded_right, density=0.0)


def test_the_hand_goes_where_grasps_are_certain():
    left_better, right_better = (
        grasp_set(SIDE, SIDE, 0.95, 0.6),
        grasp_set(SIDE, SIDE, 0.6, 0.95),
    )
    assert (side(left_better), side(right_better)) == (1.0, -1.0)
    assert side(left_better, score=0.0) == side(right_better, score=0.0)


def command(choice):
    return task_space_velocity(HOME, choice, X_WO, STILL, REACHABILITY, SAFETY, OPTIONS)


def test_density_and_score_change_the_command_and_without_them_nothing_does():
    crowd = np.concatenate([SIDE, CROWD])
    one, other = grasp_set(crowd, SIDE), grasp_set(SIDE, crowd)
    apart = command(planned(one)) - command(planned(other))
    assert np.abs(apart).max() > 0.1
    # One grasp alone: nothing to weigh, whatever its score.
    alone = [grasp_set(SIDE, SIDE[:0], score) for score in (0.3, 1.0)]
    np.testing.assert_allclose(command(planned(alone[0])), command(planned(alone[1])), atol=1e-9)


def test_scores_of_neighbours_move_the_target_continuously():
    """The chosen grasp stays; the better a neighbour, the closer to it the hand is led."""
    X_OG = from_above([(0.0, 0.05), (0.012, 0.055)])
    commands = []
    for score in np.linspace(0.5, 0.85, 36):
        grasps = GraspSet(X_OG, np.full(2, 0.05), np.array([0.9, score]))
        choice = planned(grasps)
        np.testing.assert_array_equal(choice.X_OG, X_OG[0])
        assert len(choice.weights) == 2
        commands.append(command(choice))
    steps = np.abs(np.diff(commands, axis=0)).max(axis=1)
    assert np.abs(commands[-1] - commands[0]).max() > 1e-3
    assert steps.max() < 0.2 * steps.sum()


def test_a_sharp_weight_is_the_law_that_follows_one_grasp():
    X_OG = from_above([(0.0, 0.05), (0.012, 0.055), (-0.012, 0.055)])
    grasps = GraspSet(X_OG, np.full(3, 0.05), np.array([0.9, 0.7, 0.8]))
    wide, sharp = (
        planned(grasps, replace(OPTIONS.choice, temperature=temperature))
        for temperature in (0.2, 1e-4)
    )
    alone = planned(grasps, replace(OPTIONS.choice, neighbourhood=0.0))
    assert len(sharp.weights) == 3 and len(alone.weights) == 1
    np.testing.assert_allclose(command(sharp), command(alone), atol=1e-9)
    assert np.abs(command(wide) - command(alone)).max() > 1e-4


def test_weights_are_those_of_cost_score_and_density():
    """Beside each other, in the same posture: what is left is the grasps' own price."""
    costs = OPTIONS.choice.costs
    X_OG = from_above([(0.0, 0.05), (0.001, 0.05)])
    score = np.array([0.9, 0.7])
    grasps = GraspSet(X_OG, np.full(2, 0.05), score)
    rates = costs.grasp_rates(grasps, np.array([-1.0, -3.0]))
    offset = np.linalg.norm(X_OG[:, :3, 3], axis=1) / costs.lost
    own = -costs.score * np.log(score) + costs.density * np.array([0.0, 2.0])
    np.testing.assert_allclose(rates, offset + own)
    choice = planned(grasps)
    seconds = costs.times[-1] - choice.interception_time
    cost = costs.score * seconds * np.log(0.9 / 0.7)
    assert -np.log(choice.weights[1]) * OPTIONS.choice.temperature == pytest.approx(cost, abs=0.05)
    # Outliers and worthless grasps have a finite price.
    hopeless = GraspSet(X_OG, np.full(2, 0.05), np.zeros(2))
    rates = costs.grasp_rates(hopeless, np.array([0.0, -1e4]))
    expected = offset - costs.score * np.log(LEAST_SCORE) + costs.density * RAREST * np.eye(2)[1]
    np.testing.assert_allclose(rates, expected)


def test_a_grasp_that_is_gone_keeps_its_price():
    first = planned(grasp_set(SIDE, SIDE, 0.9, 0.8))
    gone = grasp_set(SIDE[:0], SIDE, 0.9, 0.8)
    memory = TaskMemory(choice=first, seen=0.0).with_grasps(gone, 10, 0)
    ahead = np.tile(X_WO, (len(OPTIONS.choice.costs.times), 1, 1))
    after = memory.with_choice(0.1, HOME, ahead, REACHABILITY, OPTIONS.choice).choice
    np.testing.assert_array_equal(after.X_OG, first.X_OG)
    assert after.rate == first.rate > 0.0


@pytest.mark.parametrize("still_one", [True, False])
def test_a_grasp_that_left_the_set_is_followed_on_while_it_is_one(still_one):
    """Out of the set, it may be out of reach soon, or no grasp on what was seen by now."""
    left, right = grasp_set(SIDE, SIDE[:0]), grasp_set(SIDE[:0], SIDE)
    ahead = np.tile(X_WO, (len(OPTIONS.choice.costs.times), 1, 1))
    memory = TaskMemory().with_grasps(replace(left, id=np.array([3])), 10, 0)
    memory = memory.with_choice(0.0, HOME, ahead, REACHABILITY, OPTIONS.choice)
    gone = replace(right, id=np.array([4]), on_object=np.array([3, 4] if still_one else [4]))
    after = memory.with_grasps(gone, 10, 0).with_choice(
        0.1, HOME, ahead, REACHABILITY, OPTIONS.choice
    )
    expected = left if still_one else right
    np.testing.assert_array_equal(after.choice.X_OG, expected.X_OG[0])


def test_what_took_the_place_of_a_grasp_is_followed():
    memory = TaskMemory().with_grasps(grasp_set(SIDE, SIDE[:0]), 10, 0)
    ahead = np.tile(X_WO, (len(OPTIONS.choice.costs.times), 1, 1))
    memory = memory.with_choice(0.0, HOME, ahead, REACHABILITY, OPTIONS.choice)
    moved = grasp_set(from_above([(0.003, 0.06)]), SIDE)
    after = memory.with_grasps(moved, 10, 0).with_choice(
        0.1, HOME, ahead, REACHABILITY, OPTIONS.choice
    )
    np.testing.assert_array_equal(after.choice.X_OG, moved.X_OG[0])
    assert after.choice.count == memory.choice.count


def test_the_hand_reaches_a_grasp_and_not_the_mean_of_several():
    """With a neighbour on one side only, the target is off the grasp until the hand is there."""
    X_OG = from_above([(0.0, 0.05), (0.014, 0.056), (0.020, 0.05)])
    grasps = GraspSet(X_OG, np.full(3, 0.05), np.array([0.9, 0.89, 0.88]))
    q, memory, dt = HOME.copy(), TaskMemory(), 0.01
    ahead = np.tile(X_WO, (len(OPTIONS.choice.costs.times), 1, 1))
    for k in range(400):
        if k % 10 == 0:
            memory = memory.with_grasps(grasps, 10, 0)
            memory = memory.with_choice(k * dt, q, ahead, REACHABILITY, OPTIONS.choice)
        q = q + dt * task_space_velocity(
            q, memory.choice, X_WO, STILL, REACHABILITY, SAFETY, OPTIONS, time=k * dt
        )
    X_OH = se3.inverse(X_WO) @ forward_kinematics(q, REACHABILITY.gripper.X_FG)
    assert np.linalg.norm(X_OG[:, :3, 3] - X_OH[:3, 3], axis=1).min() < 5e-4
