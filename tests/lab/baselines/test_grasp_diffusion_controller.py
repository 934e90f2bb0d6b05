"""The controller that descends a learned energy: ports, limits, and what makes it stop."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform

from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.gpdf import fit_gpdf
from feasigrasp.systems.horizon_controller import RMMTaskController
from feasigrasp.systems.ports import to_value
from feasigrasp_lab.baselines.grasp_diffusion_controller import GraspDiffusionController
from tests.controller_bench import NEAR, REACH, UNKNOWN, Bench, ring

BALL = fit_gpdf(sphere_points(128, 0.03))


@pytest.fixture
def bench():
    """After an update with a field."""
    made = Bench(GraspDiffusionController)
    made.fix(gpdf=Value[object](BALL))
    made.advance(0.11)
    return made


def test_it_can_replace_the_others(ports):
    """And tells a grasp of its own beside."""
    inputs, outputs = ports(GraspDiffusionController(REACH))
    assert (inputs, outputs) == (
        ports(RMMTaskController(REACH))[0],
        ports(RMMTaskController(REACH))[1] | {"arrival": None},
    )


def test_a_field_makes_the_arm_move_within_its_limits(bench):
    qd = bench.command()
    assert np.linalg.norm(qd) > 0.05
    assert np.all(np.abs(qd) <= IIWA_7.velocity_limits)
    assert bench.dut.memory(bench.context).diffused is not None


@pytest.mark.parametrize("inputs", [{"grasps": GraspSet.empty()}, {"object_pose": UNKNOWN}])
def test_it_stops_without_grasps_and_without_a_pose(bench, inputs):
    bench.fix(**inputs)
    np.testing.assert_allclose(bench.command(), np.zeros(7), atol=1e-9)


def test_without_a_field_it_follows_the_grasp_that_it_is_given(bench):
    """As fingers close and lift, when there is no field any more."""
    bench.fix(gpdf=to_value(None))
    bench.advance(0.21)
    memory = bench.dut.memory(bench.context)
    assert memory.grasp and memory.diffused is None
    assert min(np.abs(memory.grasp.X_OG - X).max() for X in ring().X_OG) == 0.0
    bench.fix(object_pose=RigidTransform(NEAR.rotation(), NEAR.translation() + [0.0, 0.0, 0.05]))
    assert np.linalg.norm(bench.command()) > 0.05
