"""Grasps tried out in simulation: firm ones hold, hopeless ones do not."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.gripper_file import WSG_50
from feasigrasp_lab.runs.floating_gripper import (
    GRAVITY,
    LIFT_TIME,
    RAMP_TIME,
    SHAKE,
    SHAKE_PERIOD,
    FloatingGripper,
    load,
)


def turned(angle_deg):
    """A grasp from above whose closing line is turned about the approach."""
    t = np.deg2rad(angle_deg)
    X = np.eye(4)
    X[:3, :3] = np.array([[np.cos(t), np.sin(t), 0], [np.sin(t), -np.cos(t), 0], [0, 0, -1]])
    return X


def tried(obj, X, gripper=None):
    return FloatingGripper(obj, gripper or ParallelGripper()).try_grasp(X)


@pytest.fixture(scope="module")
def plate():
    mesh = trimesh.creation.box((0.03, 0.09, 0.06)).subdivide()
    return FloatingGripper(RigidObject.of_mesh("plate", mesh, 0.15), ParallelGripper())


def test_firm_grasp_holds(plate):
    trial = plate.try_grasp(turned(0.0))
    assert trial.held and trial.why == "held"


def test_grasp_beside_the_object_misses(plate):
    X = turned(0.0)
    X[2, 3] = 0.08
    trial = plate.try_grasp(X)
    assert not trial.held and trial.why == "missed"


def test_too_heavy_for_the_friction():
    """2 x 80 N x mu carry so much weight and no more; effort is shared by both pads."""
    mesh = trimesh.creation.box((0.03, 0.06, 0.06)).subdivide()
    light, heavy = (RigidObject.of_mesh("block", mesh, mass) for mass in (0.3, 30.0))
    assert tried(light, turned(0.0)).held
    assert tried(heavy, turned(0.0)).why == "dropped"


def test_finger_inside_a_cup():
    """The rim of a cup can be pinched: contact is with its wall and not with its convex hull."""
    cup = trimesh.creation.annulus(r_min=0.046, r_max=0.050, height=0.06, sections=48)
    X = turned(0.0)
    X[:3, 3] = [0.048, 0.0, 0.02]
    assert tried(RigidObject.of_mesh("ring", cup, 0.1), X).held


def test_load_is_weight_lift_and_shakes_along_all_axes():
    np.testing.assert_allclose(load(0.0), 0.0)
    np.testing.assert_allclose(load(RAMP_TIME / 2), [0, 0, GRAVITY / 2])
    start = RAMP_TIME + LIFT_TIME
    peaks = [load(start + (k + 0.25) * SHAKE_PERIOD) for k in range(3)]
    np.testing.assert_allclose(np.array(peaks) - [0, 0, GRAVITY], SHAKE * np.eye(3), atol=1e-9)


def test_another_hand_holds_what_is_too_wide_for_the_packaged_one():
    assert ParallelGripper().max_opening < 0.095 < WSG_50.max_opening
    block = RigidObject.of_mesh("block", trimesh.creation.box((0.095, 0.03, 0.06)).subdivide(), 0.1)
    assert tried(block, turned(0.0), WSG_50).held
    wide = np.roll(np.eye(4)[:, :3], 1, axis=1)  # closes along y, beside the block
    assert tried(block, np.column_stack([wide, [0, 0.1, 0, 1]]), WSG_50).why == "missed"
