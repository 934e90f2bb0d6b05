"""What the filter lets through can be reached, flips included; the rest is counted by reason."""

import numpy as np
import pytest
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix
from pydrake.multibody.math import SpatialVelocity

from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa import POSITION_LIMITS
from feasigrasp.models.iiwa_kinematics import forward_kinematics
from feasigrasp.models.reachability import Reachability
from feasigrasp.systems.reachability_filter import ReachabilityFilter

REACH = Reachability()
#: In front of the arm.
NEAR = RigidTransform(RollPitchYaw(0.2, -0.1, 0.4), [0.5, 0.0, 0.5])
STILL = SpatialVelocity.Zero()
FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def ring(n=12):
    """Grasps all round the object, approaching it horizontally and from above and below."""
    poses = []
    for k in range(n):
        R = RotationMatrix(RollPitchYaw(2 * np.pi * k / n, 0.7 * k, 0.3))
        poses.append(RigidTransform(R, [0.0, 0.0, 0.01 * k - 0.05]).GetAsMatrix4())
    return GraspSet(np.array(poses), np.full(n, 0.04), np.linspace(1.0, 0.5, n), {"earlier": 5})


@pytest.fixture
def filtered(fixed_context):
    """``filtered(grasps, pose, velocity, horizon)``: the output of the filter."""

    def evaluate(grasps, pose=NEAR, velocity=STILL, horizon=1.0):
        dut = ReachabilityFilter(REACH, horizon=horizon)
        context = fixed_context(dut, grasps=grasps, object_pose=pose, object_velocity=velocity)
        return dut.get_output_port().Eval(context)

    return evaluate


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(ReachabilityFilter(REACH))
    assert (list(inputs), list(outputs)) == documented_ports(ReachabilityFilter)
    # DESIGN: what comes out can stand in for what goes in.
    assert outputs == {"grasps": None}


def test_everything_kept_is_reached_by_a_configuration_inside_the_limits(filtered):
    grasps = filtered(ring())
    assert 0 < len(grasps) < 24
    X_WG = NEAR.GetAsMatrix4() @ grasps.X_OG
    q, travel_time = REACH.nearest(X_WG, np.zeros(7))
    assert np.isfinite(travel_time).all()
    np.testing.assert_allclose(forward_kinematics(q, REACH.gripper.X_FG), X_WG, atol=1e-9)
    assert np.all(np.abs(q) <= POSITION_LIMITS - REACH.limit_margin + 1e-12)


def test_grasps_and_flips_are_either_kept_or_counted(filtered):
    grasps = filtered(ring(), velocity=SpatialVelocity([0, 0, 0], [0.2, 0.1, 0.0]))
    dropped = {k: n for k, n in grasps.rejected.items() if k != "earlier"}
    assert {"out of reach now", "out of reach soon"} <= set(dropped)
    assert len(grasps) + sum(dropped.values()) == 24
    assert grasps.rejected["earlier"] == 5
    given = ring().with_twins()
    for X, width, score in zip(grasps.X_OG, grasps.width, grasps.score, strict=True):
        k = int(np.argmin(np.abs(given.X_OG - X).max(axis=(1, 2))))
        np.testing.assert_array_equal(given.X_OG[k], X)
        assert (given.width[k], given.score[k]) == (width, score)


def test_a_flip_may_be_reachable_where_the_grasp_is_not(filtered):
    """The wrist camera and joint limits tell the two apart: with either sign given, both come."""
    given = ring()
    flipped = GraspSet(given.X_OG @ FLIP, given.width, given.score)
    first, second = filtered(given), filtered(flipped)
    assert len(first) == len(second)
    for X in first.X_OG:
        assert np.abs(second.X_OG - X).max(axis=(1, 2)).min() < 1e-12


def test_an_object_far_away_leaves_nothing(filtered):
    grasps = filtered(ring(), pose=RigidTransform([3.0, 0.0, 0.5]))
    assert len(grasps) == 0
    assert grasps.rejected == {"earlier": 5, "out of reach now": 24}


def test_an_object_that_runs_away_leaves_nothing_soon(filtered):
    away = SpatialVelocity([0, 0, 0], [2.0, 0.0, 0.0])
    now = filtered(ring(), velocity=away, horizon=0.0)
    soon = filtered(ring(), velocity=away)
    assert len(now) > 0
    assert len(soon) == 0
    assert soon.rejected["out of reach soon"] == len(now) + now.rejected["better grasps in reach"]


def test_no_grasps_in_no_grasps_out(filtered):
    grasps = filtered(GraspSet.empty({"object not seen": 1}))
    assert len(grasps) == 0
    assert grasps.rejected == {"object not seen": 1}


def test_an_unknown_pose_reaches_nothing(filtered):
    nowhere = RigidTransform(np.full((4, 4), np.nan))
    assert len(filtered(ring(), pose=nowhere)) == 0
    assert len(filtered(ring(), velocity=SpatialVelocity(np.full(6, np.nan)))) == 0


def test_a_pose_under_the_table_is_out_of_reach(filtered):
    assert len(filtered(ring(), pose=RigidTransform([0.5, 0.0, -0.3]))) == 0
