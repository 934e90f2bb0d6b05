"""The kinematic rollout integrates what the controller commands, and nothing else."""

import json

import numpy as np
import pytest
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import LeafSystem

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.scenario.files import load_scenario
from tests.rollout import object_grasps, roll_out

SPEED = np.array([0.3, -0.2, 0.1, 0.25, -0.1, 0.2, 0.4])


class Steady(LeafSystem):
    """Asks for one joint velocity, whatever it sees; has no optional ports."""

    def __init__(self, scenario, reachability):
        super().__init__()
        self.DeclareVectorInputPort("position", IIWA_7.joints)
        self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self.DeclareVectorOutputPort(
            "commanded_velocity", IIWA_7.joints, lambda context, output: output.SetFromVector(SPEED)
        )


def scenario(name="PaperLinear", **choice):
    return load_scenario(diagram_path("dynamic.scenarios.yaml"), name, json.dumps(choice))


def test_the_arm_goes_exactly_where_a_steady_command_takes_it():
    config = scenario()
    rollout = roll_out(config, GraspSet.empty(), duration=0.5, controller=Steady)
    period = config.control.period
    # Every joint ramps up at what is sent of its acceleration limit, then moves on.
    dv = IIWA_7.acceleration_share * IIWA_7.acceleration_limits * period
    steps = np.arange(1, len(rollout.states))[:, None]
    qd = np.sign(SPEED) * np.minimum(np.abs(SPEED), steps * dv)
    q = config.start + period * np.cumsum(qd, axis=0)
    np.testing.assert_allclose(rollout.states[1:, IIWA_7.joints :], qd, atol=1e-12)
    np.testing.assert_allclose(rollout.states[1:, : IIWA_7.joints], q, atol=1e-12)
    assert rollout.metrics["no_grasp_percent"] == 100.0


def test_a_drive_that_clips_nothing_is_found_out():
    """`Steady` asks for its velocity at once: one tick beyond the limits, if the drive lets it."""
    ticks, shares = 20, {}
    for mode in ("safe", "corrected"):
        config = scenario()
        config.control.mode = mode
        duration = ticks * config.control.period
        rollout = roll_out(config, GraspSet.empty(), duration=duration, controller=Steady)
        shares[mode] = rollout.metrics["acceleration_limit_violation_percent"]
    assert shares["safe"] == 0.0
    assert shares["corrected"] == pytest.approx(100.0 / ticks, rel=0.2)


def test_the_metrics_are_those_that_are_documented():
    rollout = roll_out(scenario(), GraspSet.empty(), duration=0.1, controller=Steady)
    assert set(rollout.metrics) == set(METRICS)


def test_grasps_are_those_of_the_object_and_the_seed():
    grasps = object_grasps("small_box", seed=3, n_grasps=16)
    again = object_grasps.__wrapped__("small_box", seed=3, n_grasps=16)
    assert 0 < len(grasps) <= 16
    np.testing.assert_array_equal(grasps.X_OG, again.X_OG)
    assert np.linalg.norm(grasps.X_OG[:, :3, 3], axis=1).max() < 0.05
