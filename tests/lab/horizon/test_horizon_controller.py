"""The controller and its filter in kinematic roll-outs, and the filter on grasps."""

import numpy as np
import pytest

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability, Verdict
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp_lab.horizon.filter import intercepted_grasps
from feasigrasp_lab.horizon.law import HorizonOptions, HorizonPlan, Situation, next_plan
from feasigrasp_lab.protocols.speed import at_spin
from feasigrasp_lab.runs.rollout import object_grasps, roll_out

HOME = np.array([0.0, 0.5, 0.0, 1.2, 0.0, -1.0, 0.0])
#: The hand is at a grasp within these, as for closing [m], [rad].
TOLERANCES = 0.006, 0.08


@pytest.fixture(scope="module")
def ball():
    return object_grasps("ball", 1.0, 101)


def situation(X_WO):
    return Situation(0.0, HOME, np.zeros(7), X_WO, np.zeros(6))


def test_a_ball_that_spins_at_1_5_rad_s_is_followed_inside_the_limits(ball):
    text = "{control: {controller: horizon}, reachability: {method: interception}}"
    scenario = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachCircularMocap", text)
    scenario.random_seed = scenario.tracker.seed = 101
    scenario.object.model = "ball"
    at_spin(1.5)(scenario)
    run = roll_out(scenario, ball, duration=4.0)
    x = dict(zip(SAMPLE_NAMES, run.samples, strict=True))
    there = (x["grasp_position_error"] < TOLERANCES[0]) & (x["grasp_angle_error"] < TOLERANCES[1])
    assert there[run.times > 1.0].mean() > 0.2
    for limit in ("joint_limit", "velocity_limit", "acceleration_limit"):
        assert run.metrics[f"{limit}_violation_percent"] == 0.0
    assert run.metrics["self_collision_percent"] == 0.0


def test_the_filter_keeps_what_is_intercepted_and_says_why_the_rest_is_not(ball):
    reachability, options = Reachability(), HorizonOptions()
    judged = intercepted_grasps(
        ball,
        situation(se3.make_pose(np.eye(3), [0.55, 0.0, 0.5])),
        reachability,
        options,
        np.zeros(0, dtype=np.int64),
    )
    assert len(judged.verdicts) == 2 * len(ball)
    assert 0 < len(judged.grasps) == judged.verdicts.count(Verdict.KEPT) <= 32
    X_WG = se3.make_pose(np.eye(3), [0.55, 0.0, 0.5]) @ judged.grasps.X_OG
    assert reachability.reachable(X_WG).all()
    for reason in set(judged.verdicts) - {Verdict.KEPT}:
        assert judged.grasps.rejected[reason] == judged.verdicts.count(reason)


@pytest.mark.parametrize("at", [[3.0, 0.0, 0.5], [np.nan, 0.0, 0.5]])
def test_of_an_object_that_is_far_or_unknown_no_grasp_is_kept(ball, at):
    X_WO = np.eye(4)
    X_WO[:3, 3] = at
    judged = intercepted_grasps(
        ball, situation(X_WO), Reachability(), HorizonOptions(), np.zeros(0, dtype=np.int64)
    )
    assert len(judged.grasps) == 0
    assert set(judged.verdicts) == {Verdict.WRIST}


def test_a_hand_that_closes_keeps_to_that_grasp(ball):
    reachability, options = Reachability(), HorizonOptions()
    now = situation(se3.make_pose(np.eye(3), [0.55, 0.0, 0.5]))
    plan = next_plan(HorizonPlan(), now, ball, reachability, options)
    assert plan.X_OG is not None
    one = GraspSet(ball.X_OG[5:6], ball.width[5:6], ball.score[5:6])
    plan = next_plan(plan, now, one, reachability, options, committed=True)
    np.testing.assert_array_equal(plan.X_OG, ball.X_OG[5])
    assert np.abs(plan.v).max() <= IIWA_7.velocity_limits.max()


def test_without_grasps_there_is_no_plan(ball):
    now = situation(se3.make_pose(np.eye(3), [0.55, 0.0, 0.5]))
    plan = next_plan(HorizonPlan(), now, GraspSet.empty(), Reachability(), HorizonOptions())
    assert plan.X_OG is None
