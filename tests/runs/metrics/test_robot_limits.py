"""Self-collision and torques of runs whose answers are known."""

import time

import numpy as np
import pytest

from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.resources import diagram_path
from feasigrasp.runs.metrics.reference_robot import (
    reference_robot,
    self_collision_metrics,
    torque_metrics,
)
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station

READY = np.deg2rad([0.0, 30.0, 0.0, -60.0, 0.0, 90.0, 0.0])
FOLDED = np.array([0.0, 0.0, 0.0, -3.1, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachLinearMocap")


@pytest.fixture(scope="module")
def reference(scenario):
    return reference_robot(scenario.directives)


def test_it_is_made_once(scenario, reference):
    again = load_scenario(diagram_path("dynamic.scenarios.yaml"), "ReachCircularMocap")
    assert reference_robot(again.directives) is reference


def test_shares_of_samples_in_self_collision(reference):
    found = self_collision_metrics(reference, np.array([READY, FOLDED, READY, READY]))
    assert found["self_collision_percent"] == 25.0
    assert found["self_distance_min_mm"] < -20.0
    assert self_collision_metrics(reference, READY[None]) == {
        "self_collision_percent": 0.0,
        "self_distance_min_mm": None,
    }


def test_a_thousand_samples_take_less_than_a_second(reference):
    start = time.process_time()
    self_collision_metrics(reference, np.tile(READY, (1000, 1)))
    assert time.process_time() - start < 1.0


def test_the_weight_counts_although_the_simulated_arm_has_none(reference):
    flat = np.array([[0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]])
    (weight,) = reference.gravity_torques(flat)
    found = torque_metrics(reference, flat, np.zeros((1, 7)))
    assert found["torque_limit_violation_percent"] == 0.0
    assert found["torque_peak_percent"] == pytest.approx(
        100.0 * (np.abs(weight) / IIWA_7.effort_limits).max()
    )
    # What the motors give adds to it, with its sign.
    missing = np.sign(weight[1]) * (IIWA_7.effort_limits[1] - abs(weight[1])) * np.eye(7)[1]
    for share, expected in ((0.999, 0.0), (1.001, 100.0), (-0.999, 0.0)):
        found = torque_metrics(reference, flat, share * missing[None])
        assert found["torque_limit_violation_percent"] == expected


def test_a_torque_at_its_limit_counts_since_the_simulation_cuts_it_off(scenario, reference):
    """Asked for far more than its motors can give, the simulated arm gives the limit exactly."""
    scenario.cameras = {}
    station = make_station(scenario)
    context = station.CreateDefaultContext()
    q = scenario.start
    torques = station.GetOutputPort("arm.torque_measured")
    station.GetInputPort("gripper.position").FixValue(context, [0.085])
    station.GetInputPort("object.hold").FixValue(context, [1.0])
    desired = station.GetInputPort("arm.desired_state")
    for ahead, percent in ((0.0, 0.0), (1.0, 100.0)):
        desired.FixValue(context, np.r_[q + ahead, np.zeros(7)])
        actuation = np.array([torques.Eval(context)])
        found = torque_metrics(reference, q[None], actuation)
        assert found["torque_limit_violation_percent"] == percent
    np.testing.assert_allclose(np.abs(actuation[0]), IIWA_7.effort_limits)
