"""Grasps are rated by what the camera on the hand sees at them."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.math import RigidTransform

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.control.planning.in_view import rated_by_view
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.systems.ports import to_value
from feasigrasp.systems.reachability_filter import ViewFilter

CAMERA = Camera((223.0, 216.0, 211.5, 119.5), 424, 240, near=0.07, depth_noise=0.02)
GRIPPER = ParallelGripper()
X_HC = se3.make_pose(se3.so3_exp([np.deg2rad(25.0), 0.0, 0.0]), [0.0, 0.085, -0.105])
Q = np.array([0.3, -0.7, 0.1, -1.6, 0.1, 1.4, 0.5])
FIELD = fit_gpdf(sphere_points(64, 0.03) + [0.0, 0.1, 0.0])
GRASPS = GraspSet(se3.random_pose(np.random.default_rng(0), 8), np.full(8, 0.03), np.full(8, 0.9))


def rated(gpdf, **options):
    dut = ViewFilter(GRIPPER, CAMERA, **options)
    context = dut.CreateDefaultContext()
    X_WC = RigidTransform(forward_kinematics(Q, GRIPPER.X_FG) @ X_HC)
    for name, value in {
        "grasps": AbstractValue.Make(GRASPS),
        "gpdf": to_value(gpdf),
        "position": Q,
        "camera_pose": X_WC,
    }.items():
        dut.GetInputPort(name).FixValue(context, value)
    return dut.get_output_port().Eval(context)


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(ViewFilter(GRIPPER, CAMERA))
    assert (list(inputs), list(outputs)) == documented_ports(ViewFilter)


def test_the_camera_is_where_pose_and_joints_say():
    expected = rated_by_view(GRASPS, FIELD.points, X_HC, CAMERA)
    np.testing.assert_allclose(rated(FIELD).score, expected.score)
    assert np.ptp(expected.score) > 0.1


def test_a_hand_that_waits_is_rated_where_it_waits():
    back = se3.make_pose(np.eye(3), [0.0, 0.0, -0.15])
    behind = GraspSet(GRASPS.X_OG @ back, GRASPS.width, GRASPS.score)
    expected = rated_by_view(behind, FIELD.points, X_HC, CAMERA)
    np.testing.assert_allclose(rated(FIELD, standoff=0.15).score, expected.score)
    assert np.abs(expected.score - rated(FIELD).score).max() > 0.1


def test_without_a_field_nothing_is_rated():
    np.testing.assert_array_equal(rated(None).score, GRASPS.score)
    assert rated(None).score[0] == pytest.approx(0.9)
