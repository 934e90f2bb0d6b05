"""Which grasp is selected, what a plan keeps to, and where it leads, in kinematic loops."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.control.horizon.law import (
    HorizonOptions,
    HorizonPlan,
    next_plan,
    plan_velocity,
)
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.prediction import PredictionModel
from feasigrasp.models.reach.interception import Situation, find_interceptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

OPTIONS, REACH = HorizonOptions(), Reachability()
X_FG = REACH.gripper.X_FG
STEP = OPTIONS.program.steps[0]
Q, STILL = np.array([0.0, 0.2, 0.0, -1.4, 0.0, 1.2, 0.0]), np.zeros(6)
#: Held by the hand at Q_GRASP, the object at X_WO.
Q_GRASP = Q + np.array([0.3, 0.2, 0.1, 0.2, -0.2, 0.1, 0.2])
X_OG = se3.make_pose(se3.so3_exp([0.4, 2.0, 0.3]), [0.01, 0.02, -0.01])
X_WO = forward_kinematics(Q_GRASP, X_FG) @ se3.inverse(X_OG)

FAR = se3.make_pose(np.eye(3), [3.0, 0.0, 0.5])

both_spaces = pytest.mark.parametrize("space", [*ControlSpace])


def grasps(*X_OG, score=1.0):
    n = len(X_OG)
    return GraspSet(np.array(X_OG).reshape(n, 4, 4), np.full(n, 0.04), np.full(n, score))


def shifted(x, angle=0.0):
    """The grasp, shifted along the fingers' closing direction and turned about it."""
    return X_OG @ se3.make_pose(se3.so3_exp([angle, 0.0, 0.0]), [x, 0.0, 0.0])


def at(time=0.0, q=Q, X_WO=X_WO, V_WO=STILL, **motion):
    return Situation(time, q, np.zeros(7), X_WO, V_WO, **motion)


def planned(before, now, offered, options=OPTIONS, *, space=ControlSpace.TASK, **kwargs):
    return next_plan(before, now, offered, REACH, options, space, **kwargs)


class Selection:
    """Plans one after the other, of an arm and an object that rest."""

    def __init__(self, offered, options=OPTIONS):
        self.time, self.options = 0.0, options
        self.plan = planned(HorizonPlan(), at(), offered, options)

    def go_on(self, duration, offered, **kwargs):
        for _ in range(round(duration / STEP)):
            self.time += STEP
            self.plan = planned(self.plan, at(self.time), offered, self.options, **kwargs)
        return self.plan.X_OG


def test_a_committed_hand_that_cannot_follow_any_more_stays_where_it_is():
    """Not back to where it closed, which is where the plan before led."""
    offered, joint = grasps(X_OG), ControlSpace.JOINT
    plan = planned(HorizonPlan(), at(q=Q_GRASP), offered, space=joint, committed=True)
    q, v = Q_GRASP + 0.2, np.zeros(7)
    for k in range(1, 60):
        now = replace(at(k * STEP, q, FAR), v=v)
        plan = planned(plan, now, offered, space=joint, committed=True)
        q, v = q + 0.5 * STEP * (v + plan.v[1]), plan.v[1]
    np.testing.assert_allclose(q, Q_GRASP + 0.2, atol=1e-3)


@dataclass(frozen=True)
class Known:
    """A motion that is known exactly."""

    motion: HarmonicMotion
    now: float
    known: bool = True

    def predict(self, ahead, v_WO=None):
        return np.array([self.motion.pose(self.now + t) for t in ahead])


def circle(radius, rate):
    """A circle in the plane of the table through X_WO."""
    center = X_WO[:3, 3] - [0.0, radius, 0.0]
    amplitude, offset = np.array([radius, radius, 0.0]), np.array([0.0, 90.0, 0.0])
    turn = np.array([0.0, 0.0, 1.0]), 0.0, X_WO[:3, :3]
    return HarmonicMotion(center, amplitude, np.ones(3), offset, rate, 0.0, *turn)


@dataclass(frozen=True)
class Loop:
    """States of an arm that does what is planned, the plans, and errors to the nearest grasp."""

    q: np.ndarray
    plans: list
    errors: np.ndarray


def loop(space, motion, duration, offered, options=OPTIONS):
    """The loop at the rate of the plans, the velocity linear in between."""
    q, v, plan = Q, np.zeros(7), HorizonPlan()
    positions, plans, errors = [], [], []
    for time in STEP * np.arange(round(duration / STEP)):
        pose, twist, _ = motion.state(time)
        now = Situation(time, q, v, pose, twist, Known(motion, time), options.prediction)
        plan = planned(plan, now, offered, options, space=space)
        each = grasp_errors(offered.X_OG, se3.inverse(pose) @ forward_kinematics(q, X_FG))
        errors.append(each[np.argmin(each @ [1.0, 0.1])])
        v_next = np.zeros(7) if plan.X_OG is None else plan.v[1]
        q, v = q + 0.5 * STEP * (v + v_next), v_next
        positions.append(q)
        plans.append(plan)
    return Loop(np.array(positions), plans, np.array(errors))


SEVERAL = grasps(*(shifted(0.02 * k, 0.1 * k) for k in range(-1, 2)))
#: At rest, and at 0.3 m/s.
MOTIONS = {"resting": circle(0.0, 0.0), "circling": circle(0.15, 2.0)}


@pytest.fixture(
    scope="module",
    params=[(space, name) for space in ControlSpace for name in MOTIONS],
    ids="-".join,
)
def run(request):
    """A `Loop`, and its space and motion."""
    space, name = request.param
    return loop(space, MOTIONS[name], 5.0, SEVERAL), space, name


def test_the_hand_gets_to_a_grasp_and_stays(run):
    """For half a lap."""
    rows = round(0.5 * np.pi / STEP)
    position, angle = run[0].errors[-rows:].max(axis=0)
    assert run[0].errors[0, 0] > 0.1
    assert position < 0.003 and angle < 0.03
    assert len({plan.X_OG.tobytes() for plan in run[0].plans[-rows:]}) == 1


@pytest.mark.parametrize("prediction", [PredictionModel.TWIST, PredictionModel.NONE])
def test_with_less_prediction_it_is_farther_off_what_moves(run, prediction):
    best, space, name = run
    options = replace(OPTIONS, prediction=prediction)
    other = loop(space, MOTIONS[name], 5.0, SEVERAL, options)
    if name == "resting":
        np.testing.assert_allclose(other.q, best.q, atol=1e-9)
    else:
        assert np.median(other.errors[-75:, 0]) > 1.5 * np.median(best.errors[-75:, 0])


def test_plans_keep_velocities_and_accelerations(run):
    q, plans, program = run[0].q, run[0].plans, OPTIONS.program
    for plan in plans:
        assert (np.abs(plan.v) <= program.most_v + 1e-6).all()
        change = np.abs(np.diff(plan.v, axis=0))
        assert (change <= program.h[:, None] * program.most_a + 1e-6).all()
    assert max(np.abs(plan.v / program.most_v).max() for plan in plans) > 0.7
    assert (np.abs(q) <= np.array(IIWA_7.upper) - IIWA_7.position_margin).all()


@both_spaces
def test_the_command_is_the_plan_of_the_end_of_the_tick(space):
    plan, program = planned(HorizonPlan(), at(1.0), grasps(X_OG), space=space), OPTIONS.program
    for k in (0, 3):  # at knots
        time = 1.0 + program.times[k] - program.safety.period
        np.testing.assert_allclose(plan_velocity(plan, time, program), plan.v[k], atol=1e-12)
    middle = 1.0 + 0.5 * STEP - program.safety.period
    expected = 0.5 * (plan.v[0] + plan.v[1])
    np.testing.assert_allclose(plan_velocity(plan, middle, program), expected, atol=1e-12)


def saving(offered, other):
    """A score for one grasp with which another, of score 1, saves exactly this [s]."""

    def score(seconds, present):
        X, ones = np.array([offered, other, offered]), np.ones(3)
        found = find_interceptions(X, ones, at(), REACH, OPTIONS.interception, present)
        lead = found.cost[-1] - found.cost[1]
        return float(np.exp((lead - seconds) / OPTIONS.interception.score))

    return score


@pytest.mark.parametrize(("seconds", "switches"), [(0.27, False), (0.33, True)])
def test_another_grasp_is_selected_if_it_saves_enough(seconds, switches):
    """0.3 s by default."""
    first, other = X_OG, shifted(0.03)
    selection = Selection(grasps(first))
    present = int(selection.plan.near.branch[0]), float(selection.plan.near.psi[0])
    score = saving(first, other)(seconds, present)
    assert 0.05 < score < 1.0
    two = GraspSet(np.array([first, other]), np.full(2, 0.04), np.array([score, 1.0]))
    selected = selection.go_on(0.2, two)
    np.testing.assert_array_equal(selected, other if switches else first)


def test_without_hysteresis_the_better_one_is_selected():
    first, other, options = X_OG, shifted(0.03), replace(OPTIONS, switch=0.0)
    for seconds, best in ((0.02, other), (-0.02, first)):
        selection = Selection(grasps(first), options)
        present = int(selection.plan.near.branch[0]), float(selection.plan.near.psi[0])
        score = saving(first, other)(seconds, present)
        two = GraspSet(np.array([first, other]), np.full(2, 0.04), np.array([score, 1.0]))
        np.testing.assert_array_equal(selection.go_on(0.2, two), best)


def test_grasps_are_ranked_at_their_rate():
    first, other = X_OG, shifted(0.03)
    selection = Selection(grasps(first))
    two = GraspSet(np.array([first, other]), np.full(2, 0.04), np.array([0.1, 1.0]))
    np.testing.assert_array_equal(selection.go_on(0.08, two), first)
    np.testing.assert_array_equal(selection.go_on(0.02, two), other)


def test_a_grasp_that_is_not_offered_any_more_is_followed_for_a_while():
    other = shifted(0.05)
    for offered, then in ((grasps(other), other), (GraspSet.empty(), None)):
        selection = Selection(grasps(X_OG))
        np.testing.assert_array_equal(selection.go_on(0.48, offered), X_OG)
        selected = selection.go_on(0.06, offered)
        if then is None:
            assert selected is None
        else:
            np.testing.assert_array_equal(selected, then)


def test_a_grasp_that_cannot_be_met_any_more_is_followed_for_a_while():
    """Though it is offered: the object has gone too far."""
    plan = planned(HorizonPlan(), at(), grasps(X_OG))
    for time, selected in ((0.1, True), (0.48, True), (0.6, False)):
        plan = planned(plan, at(time, X_WO=FAR), grasps(X_OG))
        assert (plan.X_OG is not None) == selected
    # One that comes back in time is not given up.
    plan = planned(HorizonPlan(), at(), grasps(X_OG))
    for time, X in ((0.3, FAR), (0.4, X_WO), (0.8, FAR)):
        plan = planned(plan, at(time, X_WO=X), grasps(X_OG))
    np.testing.assert_array_equal(plan.X_OG, X_OG)


def test_a_grasp_that_is_sampled_anew_is_the_same_one():
    """Its place follows, and the arm angle stays, while others save nothing."""
    selection = Selection(grasps(X_OG))
    psi = selection.plan.near.psi[0]
    for k in range(1, 7):
        moved = shifted(0.006 * k, 0.05 * k)
        np.testing.assert_array_equal(selection.go_on(0.1, grasps(moved)), moved)
        assert selection.plan.seen == pytest.approx(selection.time)
    assert selection.plan.near.psi[0] == psi


def test_a_hand_that_closes_keeps_to_the_first_grasp_in_its_configuration():
    selection, first = Selection(grasps(X_OG, shifted(0.02))), shifted(0.3)
    selected = selection.go_on(STEP, grasps(first, X_OG), committed=True)
    np.testing.assert_array_equal(selected, first)
    plan = selection.plan
    assert len(plan.near.X_OG) == len(plan.near.penalty) == 1
    assert plan.near.branch.tolist() == [branch_kernel(IIWA_7.chain, Q)]
    assert plan.near.psi[0] == pytest.approx(arm_angle_kernel(IIWA_7.chain, Q))
    np.testing.assert_array_equal(plan.q, Q)


def test_a_hand_that_closes_on_the_grasp_it_went_for_keeps_its_configuration():
    selection = Selection(grasps(X_OG, shifted(0.02)))
    before = selection.plan
    selection.go_on(STEP, grasps(before.X_OG), committed=True)
    plan = selection.plan
    assert len(before.near.X_OG) == 2 and len(plan.near.X_OG) == len(plan.near.penalty) == 1
    assert (plan.near.branch[0], plan.near.psi[0]) == (before.near.branch[0], before.near.psi[0])
    assert plan.arrival == plan.time


UNKNOWN = [
    {"X_WO": np.full((4, 4), np.nan)},
    {"V_WO": np.full(6, np.nan)},
    {"X_WO": FAR},
]


@both_spaces
@pytest.mark.parametrize("lost", UNKNOWN, ids=["pose unknown", "twist unknown", "out of reach"])
def test_without_anything_to_follow_there_is_no_grasp_and_the_command_is_to_stop(space, lost):
    plan = planned(HorizonPlan(), at(**lost), grasps(X_OG), space=space)
    assert plan.X_OG is None
    np.testing.assert_array_equal(plan_velocity(plan, 0.0, OPTIONS.program), np.zeros(7))
    again = planned(plan, at(STEP), grasps(X_OG), space=space)
    assert np.linalg.norm(plan_velocity(again, STEP, OPTIONS.program)) > 0.01


def test_without_grasps_there_is_none_selected():
    assert planned(HorizonPlan(), at(), GraspSet.empty()).X_OG is None


def test_an_object_that_is_lost_is_selected_for_anew():
    """Of the plan before nothing is left."""
    before = planned(HorizonPlan(), at(), grasps(X_OG))
    lost = planned(before, at(STEP, X_WO=np.full((4, 4), np.nan)), grasps(X_OG))
    assert lost.X_OG is None
    other = shifted(0.05)
    np.testing.assert_array_equal(planned(lost, at(2 * STEP), grasps(other)).X_OG, other)


def test_neighbours_are_near_and_held_alike():
    """Both ways round, and on all sides, there are grasps that are not."""
    rng = np.random.default_rng(0)
    noise = rng.uniform(-1.0, 1.0, (60, 6)) * np.repeat([0.5, 0.05], 3)
    offered = GraspSet(X_OG @ se3.exp(noise), np.full(60, 0.04), np.ones(60)).with_symmetric()
    plan = planned(HorizonPlan(), at(), offered, replace(OPTIONS, neighbours=30))
    errors = grasp_errors(plan.near.X_OG, plan.X_OG)
    assert 3 <= len(plan.near.X_OG) < 30
    assert (errors < [0.05, 0.6]).all() and errors[0] == pytest.approx(0.0, abs=1e-6)
    assert (plan.near.branch == plan.near.branch[0]).all()
    penalty = plan.near.penalty
    assert penalty[0] == 0.0 and (penalty >= 0.0).all() and penalty.max() > 0.0
    found = find_interceptions(offered.X_OG, offered.score, at(), REACH, OPTIONS.interception)
    assert found.cost.min() == found.cost[np.abs(offered.X_OG - plan.X_OG).max(axis=(1, 2)) == 0]
    # Of them the nearest, as many as may be.
    nearest = np.argsort((errors / [0.05, 0.6]).max(axis=1), kind="stable")
    for most in (1, 3):
        few = planned(HorizonPlan(), at(), offered, replace(OPTIONS, neighbours=most))
        np.testing.assert_array_equal(few.near.X_OG, plan.near.X_OG[nearest][:most])
