"""What a judge of hand poses lets through; the rest is explained."""

from collections import Counter

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from feasigrasp.errors import ReachabilityError, ScenarioError
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp_lab.mixtures.mixture import RiemannianMixture
from feasigrasp_lab.paper.judge import JudgedFilter, PoseJudge
from feasigrasp_lab.paper.reachable_space import ReachableSpace

REACH = Reachability()
#: In front of the arm.
NEAR = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
STILL = SpatialVelocity.Zero()
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])
UNLIKELY = "unlikely under the reachable-space mixture"


def ring(n=12):
    """Grasps all round the object, approaching it horizontally and from above and below."""
    poses = []
    for k in range(n):
        R = RotationMatrix(RollPitchYaw(2 * np.pi * k / n, 0.7 * k, 0.3))
        poses.append(RigidTransform(R, [0.0, 0.0, 0.01 * k - 0.05]).GetAsMatrix4())
    return GraspSet(np.array(poses), np.full(n, 0.04), np.linspace(1.0, 0.5, n), {"earlier": 5})


def left_side():
    """A density that is high within about 0.4 m of (0.5, 0.3, 0.5), whatever the orientation."""
    mean = RigidTransform([0.5, 0.3, 0.5]).GetAsMatrix4()
    covariance = np.diag([1e4, 1e4, 1e4, 0.04, 0.04, 0.04])
    mixture = RiemannianMixture(np.ones(1), mean[None], covariance[None])
    edge = mixture.log_density(RigidTransform([0.5, 0.75, 0.5]).GetAsMatrix4()[None])
    return ReachableSpace(mixture, float(np.ravel(edge)[0]))


@pytest.fixture
def evaluate(fixed_context):
    """``evaluate(grasps, pose, velocity, **settings)``: grasps and verdicts of the filter."""

    def both(grasps, pose=NEAR, velocity=STILL, judge=REACH, **settings):
        dut = JudgedFilter(judge, **settings)
        context = fixed_context(dut, grasps=grasps, object_pose=pose, object_velocity=velocity)
        return [dut.GetOutputPort(name).Eval(context) for name in ("grasps", "verdicts")]

    return both


@pytest.fixture
def filtered(evaluate):
    """``filtered(grasps, pose, velocity, **settings)``: the grasps alone."""
    return lambda *args, **settings: evaluate(*args, **settings)[0]


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(JudgedFilter(REACH))
    assert (list(inputs), list(outputs)) == documented_ports(JudgedFilter)
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


@pytest.mark.parametrize("method", ["ik", "rmm", "both"])
def test_grasps_and_flips_are_either_kept_or_counted(evaluate, method):
    velocity = SpatialVelocity([0, 0, 0], [0.2, 0.1, 0.0])
    grasps, verdicts = evaluate(
        ring(),
        pose=RigidTransform([0.5, 0.1, 0.4]),
        velocity=velocity,
        judge=PoseJudge(REACH, method, left_side()),
    )
    assert len(verdicts) == 24
    dropped = {k: n for k, n in grasps.rejected.items() if k != "earlier"}
    assert dropped == {k: n for k, n in Counter(verdicts).items() if k != "kept"}
    assert len(grasps) == verdicts.count("kept") > 0
    assert len(set(verdicts)) >= {"ik": 4, "rmm": 2, "both": 3}[method]
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
    away = SpatialVelocity([0, 0, 0], [2.0, 0.0, 0.0])
    now = filtered(ring(), velocity=away, horizon=0.0, way_in=0.0)
    soon = filtered(ring(), velocity=away)
    assert len(now) > 0
    assert len(soon) == 0
    assert soon.rejected["out of reach soon"] == len(now) + now.rejected["better grasps in reach"]


@pytest.mark.parametrize("method", ["ik", "rmm", "both"])
def test_no_grasps_in_no_grasps_out(evaluate, method):
    settings = {"judge": PoseJudge(REACH, method, left_side())}
    grasps, verdicts = evaluate(GraspSet.empty({"object not seen": 1}), **settings)
    assert len(grasps) == 0 and verdicts == ()
    assert grasps.rejected == {"object not seen": 1}


@pytest.mark.parametrize("method", ["ik", "rmm", "both"])
def test_an_unknown_pose_reaches_nothing(filtered, method):
    settings = {"judge": PoseJudge(REACH, method, left_side())}
    nowhere = RigidTransform(np.full((4, 4), np.nan))
    assert len(filtered(ring(), pose=nowhere, **settings)) == 0
    unknown = SpatialVelocity(np.full(6, np.nan))
    assert len(filtered(ring(), velocity=unknown, **settings)) == 0


def test_a_pose_under_the_table_is_out_of_reach(evaluate):
    grasps, verdicts = evaluate(ring(), pose=RigidTransform([0.5, 0.0, -0.3]))
    assert len(grasps) == 0
    assert "table" in verdicts


def test_the_mixture_alone_decides_with_rmm(evaluate):
    """It knows nothing of limits and collisions."""
    judge = PoseJudge(REACH, "rmm", left_side())
    for y, expected in ((0.3, {"kept", "better grasps in reach"}), (-0.6, {UNLIKELY})):
        pose = RigidTransform([0.5, y, 0.5])
        _, verdicts = evaluate(ring(), pose=pose, judge=judge)
        assert set(verdicts) == expected


def test_both_is_exact_on_what_the_mixture_lets_through(evaluate):
    given = ring()
    grasps = GraspSet(given.X_OG, given.width, np.ones(len(given)))  # none is left out as worse
    settings = {"pose": RigidTransform([0.45, -0.03, 0.4]), "horizon": 0.0, "way_in": 0.0}
    methods = ("ik", "rmm", "both")
    ik, rmm, both = (
        evaluate(grasps, judge=PoseJudge(REACH, method, left_side()), **settings)[1]
        for method in methods
    )
    expected = [e if likely == "kept" else likely for e, likely in zip(ik, rmm, strict=True)]
    assert list(both) == expected
    assert len(set(both)) >= 3 and UNLIKELY in both and "kept" in both


def test_the_packaged_space_is_the_default(evaluate):
    """It lets through what the arm reaches, and little that is far away."""
    _, verdicts = evaluate(ring(), judge=PoseJudge(REACH, "rmm"))
    assert verdicts.count("kept") > 0
    _, verdicts = evaluate(
        ring(), pose=RigidTransform([2.0, 0.0, 0.5]), judge=PoseJudge(REACH, "rmm")
    )
    assert set(verdicts) == {UNLIKELY}


def test_an_unknown_method_is_refused():
    file = diagram_path("dynamic.scenarios.yaml")
    with pytest.raises(ScenarioError, match="reachability.method is 'exact'; choose one of ik"):
        load_scenario(file, "ReachLinearMocap", "{reachability: {method: exact}}")
    assert load_scenario(file, "ReachLinearMocap").reachability.method == "ik"
    with pytest.raises(ReachabilityError, match="'exact'; choose one of ik, rmm, both"):
        PoseJudge(REACH, "exact")
