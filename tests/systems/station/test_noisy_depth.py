"""The sensor model as a system, alone and in the station."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.systems.sensors import CameraInfo, ImageDepth32F, ImageLabel16I

from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario
from feasigrasp.systems.from_scenario import make_station
from feasigrasp.systems.station.camera import NoisyDepth

INFO = CameraInfo(64, 48, 60.0, 60.0, 31.5, 23.5)


def depth_image(data):
    image = ImageDepth32F(data.shape[1], data.shape[0])
    image.mutable_data[:, :, 0] = data
    return image


X_WO = RigidTransform([0.0, 0.0, 0.5])


def noisy(dut, fixed_context, data, time=0.0):
    labels = ImageLabel16I(data.shape[1], data.shape[0])
    inputs = {"label_image": labels, "camera_pose": RigidTransform(), "object_pose": X_WO}
    context = fixed_context(dut, depth_image=depth_image(data), **inputs)
    context.SetTime(time)
    return dut.get_output_port().Eval(context).data[:, :, 0].copy()


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(NoisyDepth(DepthNoise(), INFO))
    assert (list(inputs), list(outputs)) == documented_ports(NoisyDepth)


def test_the_errors_depend_on_time_and_seed_only(fixed_context):
    flat = np.full((48, 64), 0.5)
    first = noisy(NoisyDepth(DepthNoise(), INFO, seed=1), fixed_context, flat, 0.5)
    again = noisy(NoisyDepth(DepthNoise(), INFO, seed=1), fixed_context, flat, 0.5)
    np.testing.assert_array_equal(first, again)
    later = noisy(NoisyDepth(DepthNoise(), INFO, seed=1), fixed_context, flat, 1.0)
    other = noisy(NoisyDepth(DepthNoise(), INFO, seed=2), fixed_context, flat, 0.5)
    # Three quarters stay with the pixels and the wall; another camera has errors of its own.
    for different, expected in ((later, 0.75), (other, 0.0)):
        seen = np.isfinite(first) & np.isfinite(different)
        found = np.corrcoef(first[seen], different[seen])[0, 1]
        assert found == pytest.approx(expected, abs=0.12)


def test_the_noise_is_that_of_the_cameras_focal_length(fixed_context):
    noise = DepthNoise(disparity_step=0.0, depth_step=0.0, fixed=0.0, correlation=0.0)
    error = noisy(NoisyDepth(noise, INFO), fixed_context, np.full((48, 64), 0.5)) - 0.5
    straight = error[16:32, 24:40]  # rays at right angles to the wall
    assert np.std(straight) == pytest.approx(0.5**2 * 0.08 / (60.0 * 0.05), rel=0.12)


def test_in_the_station_cloud_and_depth_image_carry_the_same_noise():
    """Along the optical axis the cloud is the noisy depth; the labels know nothing of it."""
    file, images = diagram_path("dynamic.scenarios.yaml"), {}
    same = "sensors: {joints: {encoder_zero_deg: 0}}"
    alone = "decimation: 1, depth_step: 0, scale_error: 0, bias: 0, holes: 0"
    for noise in ("{}", f"{{wrist_camera: {{{alone}}}}}"):
        text = f"{{{same}, camera_noise: {noise}}}"
        station = make_station(load_scenario(file, "ReachLinearMocap", text))
        context = station.CreateDefaultContext()
        cloud, depth, label, pose = (
            station.GetOutputPort(f"wrist_camera.{name}").Eval(context)
            for name in ("point_cloud", "depth_image", "label_image", "pose")
        )
        z = (pose.inverse() @ cloud.xyzs())[2].reshape(depth.data.shape[:2])
        images[text] = depth.data[:, :, 0].copy(), z, label.data.copy()
    (true, true_z, true_label), (depth, z, label) = images.values()
    seen = np.isfinite(z)
    np.testing.assert_allclose(z[seen], depth[seen], atol=1e-5)
    np.testing.assert_array_equal(label, true_label)
    assert 0.5 < seen.sum() / np.isfinite(true_z).sum() < 1.0
    near = seen & (true > 0.0) & (true < 0.6)
    focal = true.shape[1] / 2 / np.tan(np.deg2rad(87.0 / 2))
    in_sigmas = (depth[near] - true[near]) / (true[near] ** 2 * 0.08 / (focal * 0.05))
    assert 0.95 < 1.4826 * np.median(np.abs(in_sigmas)) < 1.8  # more on oblique surfaces


def test_a_calibration_error_moves_cloud_and_pose_alike():
    """What is seen stays in the camera's picture, and the cloud is off in the world."""
    file = diagram_path("dynamic.scenarios.yaml")
    off = "{camera_noise: {wrist_camera: {hand_eye_position: 0.01, hand_eye_angle_deg: 1}}}"
    seen = []
    for text in ("{camera_noise: {wrist_camera: {}}}", off):
        station = make_station(load_scenario(file, "ReachLinearMocap", text))
        context = station.CreateDefaultContext()
        pose = station.GetOutputPort("wrist_camera.pose").Eval(context)
        cloud = station.GetOutputPort("wrist_camera.point_cloud").Eval(context).xyzs()
        finite = np.isfinite(cloud).all(axis=0)
        seen.append((pose, pose.inverse() @ cloud[:, finite].astype(float)))
    (true, true_points), (calibrated, points) = seen
    np.testing.assert_allclose(points, true_points, atol=1e-5)
    error = true.inverse() @ calibrated
    assert np.linalg.norm(error.translation()) == pytest.approx(0.01)
    assert error.rotation().ToAngleAxis().angle() == pytest.approx(np.deg2rad(1.0), rel=1e-6)


def test_the_camera_of_its_own_looks_towards_the_pads():
    file = diagram_path("dynamic.scenarios.yaml")
    station = make_station(
        load_scenario(file, "ReachLinear", "{camera_noise: {}, sensors: {error_factor: 0}}")
    )
    context = station.CreateDefaultContext()
    z_C = station.GetOutputPort("wrist_camera.pose").Eval(context).rotation().col(2)
    inside = station.plant.GetMyContextFromRoot(context)
    X_WG = station.plant.GetFrameByName("grasp_frame").CalcPoseInWorld(inside)
    X_WC = station.GetOutputPort("wrist_camera.pose").Eval(context)
    assert np.rad2deg(np.arccos(z_C @ X_WG.rotation().col(2))) == pytest.approx(25.0, abs=1e-3)
    # The pads' centre and the tips are in the picture, 58 degrees high, and farther than 0.07 m.
    for p in ([0.0, 0.0, 0.0], [0.0, 0.0, 0.025]):
        x, y, z = X_WC.inverse() @ (X_WG @ np.array(p))
        assert z > 0.1 and abs(x) < 1e-6
        assert abs(np.rad2deg(np.arctan2(y, z))) < 16.0
