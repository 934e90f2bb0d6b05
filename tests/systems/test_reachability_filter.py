"""What the filter lets through can be reached, flips included; the rest is explained."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems import reachability_filter
from feasigrasp.systems.reachability_filter import FeasiblePoses, ReachabilityFilter

REACH = Reachability()
#: In front of the arm.
NEAR = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
STILL = SpatialVelocity.Zero()
HOME = np.array([0.0, 0.2, 0.0, -1.4, 0.0, 1.2, 0.0])
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def ring(n=12):
    """Grasps all round the object, approaching it horizontally and from above and below."""
    poses = []
    for k in range(n):
        R = RotationMatrix(RollPitchYaw(2 * np.pi * k / n, 0.7 * k, 0.3))
        poses.append(RigidTransform(R, [0.0, 0.0, 0.01 * k - 0.05]).GetAsMatrix4())
    return GraspSet(np.array(poses), np.full(n, 0.04), np.linspace(1.0, 0.5, n), {"earlier": 5})


@pytest.fixture
def evaluate(fixed_context):
    """``evaluate(grasps, pose, velocity, inputs, **settings)``: grasps and verdicts."""

    def both(grasps, pose=NEAR, velocity=STILL, inputs=None, **settings):
        dut, given = ReachabilityFilter(REACH, **settings), {"position": HOME} | (inputs or {})
        context = fixed_context(
            dut, grasps=grasps, object_pose=pose, object_velocity=velocity, **given
        )
        return [dut.GetOutputPort(name).Eval(context) for name in ("grasps", "verdicts")]

    return both


@pytest.fixture
def filtered(evaluate):
    """``filtered(grasps, pose, velocity, **settings)``: the grasps alone."""
    return lambda *args, **settings: evaluate(*args, **settings)[0]


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(ReachabilityFilter(REACH))
    assert (list(inputs), list(outputs)) == documented_ports(ReachabilityFilter)
    assert (inputs["position"], inputs["desired_velocity"]) == (7, 7)
    # DESIGN: what comes out can stand in for what goes in.
    assert outputs == {"grasps": None, "verdicts": None}


def test_everything_kept_is_reached_by_a_configuration_inside_the_limits(filtered):
    grasps = filtered(ring())
    assert 0 < len(grasps) < 24
    X_WG = NEAR.GetAsMatrix4() @ grasps.X_OG
    q, travel_time = REACH.nearest(X_WG, np.zeros(7))
    assert np.isfinite(travel_time).all()
    np.testing.assert_allclose(forward_kinematics(q, REACH.gripper.X_FG), X_WG, atol=1e-9)
    assert np.all(np.abs(q) <= IIWA_7.upper - REACH.limit_margin + 1e-12)


def test_grasps_and_flips_are_either_kept_or_counted(evaluate):
    velocity = SpatialVelocity([0, 0, 0], [0.2, 0.1, 0.0])
    grasps, verdicts = evaluate(ring(), pose=RigidTransform([0.5, 0.1, 0.4]), velocity=velocity)
    assert len(verdicts) == 24
    dropped = {k: n for k, n in grasps.rejected.items() if k != "earlier"}
    assert dropped == {k: n for k, n in Counter(verdicts).items() if k != "kept"}
    assert len(grasps) == verdicts.count("kept") > 0
    assert len(set(verdicts)) >= 3
    assert grasps.rejected["earlier"] == 5
    given = ring().with_symmetric()
    kept = {X.tobytes() for X in grasps.X_OG}
    assert [X.tobytes() in kept for X in given.X_OG] == [v == "kept" for v in verdicts]
    for X, width, score in zip(grasps.X_OG, grasps.width, grasps.score, strict=True):
        k = int(np.argmin(np.abs(given.X_OG - X).max(axis=(1, 2))))
        assert (given.width[k], given.score[k]) == (width, score)


def test_a_flip_may_be_reachable_where_the_grasp_is_not(filtered):
    """The wrist camera and joint limits tell the two apart: with either sign given, both come."""
    given = ring()
    flipped = GraspSet(given.X_OG @ FLIP, given.width, given.score)
    first, second = filtered(given), filtered(flipped)
    assert len(first) == len(second)
    for X in first.X_OG:
        assert np.abs(second.X_OG - X).max(axis=(1, 2)).min() < 1e-12


def test_an_object_far_away_leaves_nothing(evaluate):
    grasps, verdicts = evaluate(ring(), pose=RigidTransform([3.0, 0.0, 0.5]))
    assert len(grasps) == 0
    assert grasps.rejected == {"earlier": 5, "wrist out of reach": 24}
    assert verdicts == ("wrist out of reach",) * 24


def test_an_object_that_runs_away_leaves_nothing_soon(filtered):
    now, soon = (
        filtered(ring(), velocity=SpatialVelocity([0, 0, 0], [speed, 0.0, 0.0]))
        for speed in (0.0, 2.0)
    )
    assert len(now) > 0
    assert len(soon) == 0
    assert soon.rejected["out of reach soon"] >= len(now)


def test_no_grasps_in_no_grasps_out(evaluate):
    grasps, verdicts = evaluate(GraspSet.empty({"object not seen": 1}))
    assert len(grasps) == 0 and verdicts == ()
    assert grasps.rejected == {"object not seen": 1}


def test_an_unknown_pose_reaches_nothing(filtered):
    nowhere = RigidTransform(np.full((4, 4), np.nan))
    assert len(filtered(ring(), pose=nowhere)) == 0
    unknown = SpatialVelocity(np.full(6, np.nan))
    assert len(filtered(ring(), velocity=unknown)) == 0


def test_without_a_velocity_the_arm_is_taken_to_rest(evaluate):
    fast = SpatialVelocity([0, 0, 0], [0.0, 0.5, 0.0])
    bare = evaluate(ring(), velocity=fast)
    rests = evaluate(ring(), velocity=fast, inputs={"desired_velocity": np.zeros(7)})
    assert bare[1] == rests[1]
    np.testing.assert_array_equal(bare[0].X_OG, rests[0].X_OG)
    swings = evaluate(ring(), velocity=fast, inputs={"desired_velocity": np.full(7, -1.2)})
    assert not np.array_equal(swings[0].X_OG, bare[0].X_OG)  # they are in the order of their costs


class Elsewhere:
    """A motion that takes the object out of reach."""

    known = True

    def predict(self, ahead, v_WO=None):
        way = np.array([0.0, 0.0, 2.0])
        return np.array(
            [
                RigidTransform(NEAR.rotation(), NEAR.translation() + t * way).GetAsMatrix4()
                for t in ahead
            ]
        )


@pytest.mark.parametrize(
    ("prediction", "few"), [("predicted", True), ("twist", False), ("none", False)]
)
def test_the_motion_counts_if_the_prediction_is_asked_for(evaluate, prediction, few):
    """Without ``object_motion`` the object goes on with its twist."""
    motion = {"object_motion": Value[object](Elsewhere())}
    grasps, _ = evaluate(ring(), inputs=motion, prediction=prediction)
    still, _ = evaluate(ring(), prediction=prediction)
    assert len(still) > 0
    assert len(grasps) == (0 if few else len(still))


def test_what_was_kept_is_remembered(filtered):
    """Every 0.1 s, by id: of grasps that cost nearly as much, most that were kept stay."""
    dut = ReachabilityFilter(REACH, symmetric_grasps=False)
    rng = np.random.default_rng(0)
    many = filtered(ring()).X_OG[0] @ se3.exp(0.02 * rng.normal(size=(80, 6)))
    given = GraspSet(many, np.full(80, 0.04), np.linspace(0.3, 1.0, 80), id=np.arange(80))
    simulator = Simulator(dut)
    context, kept = simulator.get_mutable_context(), []
    for time, score in ((0.01, given.score), (0.02, given.score[::-1]), (0.11, given.score[::-1])):
        for name, value in {
            "grasps": AbstractValue.Make(replace(given, score=score.copy())),
            "object_pose": AbstractValue.Make(NEAR),
            "object_velocity": AbstractValue.Make(STILL),
            "position": HOME,
        }.items():
            dut.GetInputPort(name).FixValue(context, value)
        simulator.AdvanceTo(time)
        kept.append(set(dut.GetOutputPort("grasps").Eval(context).id))
    fresh = dut.CreateDefaultContext()
    for name in ("grasps", "object_pose", "object_velocity", "position"):
        dut.GetInputPort(name).FixValue(fresh, dut.GetInputPort(name).Eval(context))
    alone = set(dut.GetOutputPort("grasps").Eval(fresh).id)
    common = [len(each & kept[0]) for each in (alone, *kept[1:])]
    assert common[0] < 0.8 * len(kept[0]) and min(common[1:]) >= 0.9 * len(kept[0])


def test_grasps_are_judged_anew_as_time_passes(fixed_context, monkeypatch):
    times, judge = [], reachability_filter.feasible_grasps

    def judged(grasps, now, *given, **options):
        times.append(now.time)
        return judge(grasps, now, *given, **options)

    monkeypatch.setattr(reachability_filter, "feasible_grasps", judged)
    inputs = {"grasps": ring(1), "object_pose": NEAR, "object_velocity": STILL, "position": HOME}
    dut = ReachabilityFilter(REACH)
    context = fixed_context(dut, **inputs)
    for time in (0.0, 1.0):
        context.SetTime(time)
        dut.GetOutputPort("grasps").Eval(context)
    assert times == [0.0, 1.0]


def test_a_pose_under_the_table_is_out_of_reach(evaluate):
    grasps, verdicts = evaluate(ring(), pose=RigidTransform([0.5, 0.0, -0.3]))
    assert len(grasps) == 0
    assert "table" in verdicts


def test_the_system_of_verdicts_says_what_the_filter_says_of_every_grasp(
    evaluate, fixed_context, ports, documented_ports
):
    """Of 1,000 poses round the object, moving and at rest."""
    dut = FeasiblePoses(REACH)
    assert tuple(map(list, ports(dut))) == documented_ports(FeasiblePoses)
    rng = np.random.default_rng(0)
    R = se3.so3_exp(rng.normal(0.0, 1.2, (1000, 3)))
    poses = se3.make_pose(R, rng.uniform(-0.3, 0.3, (1000, 3)))
    grasps = GraspSet(poses, np.full(1000, 0.04), np.ones(1000))
    moving = SpatialVelocity([0.0, 0.0, 0.3], [0.1, -0.1, 0.0])
    for velocity in (STILL, moving):
        _, theirs = evaluate(grasps, velocity=velocity, symmetric_grasps=False)
        given = {"object_pose": NEAR, "object_velocity": velocity, "position": HOME}
        context = fixed_context(dut, grasps=grasps, **given)
        found = dut.GetOutputPort("feasibility").Eval(context)
        in_reach = ("kept", "better grasps in reach")
        expected = ["reachable" if verdict in in_reach else verdict for verdict in theirs]
        assert list(found.verdicts) == expected and len(Counter(expected)) > 3
    unknown = RigidTransform(np.full((4, 4), np.nan))
    context = fixed_context(dut, grasps=grasps, **(given | {"object_pose": unknown}))
    assert not dut.GetOutputPort("feasibility").Eval(context)
