"""Segmentation keeps exactly the finite pixels with the body's label, edges apart."""

import numpy as np
import pytest
from pydrake.math import RigidTransform
from pydrake.perception import DepthImageToPointCloud, PointCloud
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.sensors import CameraInfo, ImageDepth32F, ImageLabel16I, PixelType

from feasigrasp.models.clouds.camera import Camera
from feasigrasp.systems.ports import evaluate
from feasigrasp.systems.segmentation.segment_point_cloud import SegmentPointCloud

LABEL = 7


def cloud_of(xyz):
    cloud = PointCloud(xyz.shape[1])
    cloud.mutable_xyzs()[:] = xyz
    return cloud


def label_image(labels):
    image = ImageLabel16I(labels.shape[1], labels.shape[0])
    image.mutable_data[:, :, 0] = labels
    return image


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(SegmentPointCloud(LABEL, smears=True))
    assert (list(inputs), list(outputs)) == documented_ports(SegmentPointCloud)
    assert set(inputs.values()) == set(outputs.values()) == {None}


def test_it_keeps_exactly_the_labelled_finite_pixels_in_order(fixed_context):
    rng = np.random.default_rng(0)
    xyz = rng.uniform(0.0, 0.003, size=(3, 6 * 8)).astype(np.float32)  # without edges
    labels = rng.choice([LABEL, 3], size=(6, 8))
    bad = (labels.ravel() == LABEL) & (rng.random(48) < 0.4)
    xyz[rng.integers(3, size=48)[bad], np.flatnonzero(bad)] = rng.choice(
        [np.nan, np.inf, -np.inf], bad.sum()
    )
    dut = SegmentPointCloud(LABEL)
    context = fixed_context(dut, point_cloud=cloud_of(xyz), label_image=label_image(labels))
    kept = dut.GetOutputPort("point_cloud").Eval(context).xyzs()
    expected = [
        xyz[:, 8 * row + column]
        for row in range(6)
        for column in range(8)
        if labels[row, column] == LABEL and not bad[8 * row + column]
    ]
    assert 0 < len(expected) < (labels == LABEL).sum()
    np.testing.assert_array_equal(kept, np.transpose(expected))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_without_a_valid_pixel_the_cloud_is_empty(fixed_context, value):
    xyz = np.full((3, 4), value, dtype=np.float32)
    dut = SegmentPointCloud(LABEL)
    labels = np.full((2, 2), LABEL)
    context = fixed_context(dut, point_cloud=cloud_of(xyz), label_image=label_image(labels))
    assert dut.GetOutputPort("point_cloud").Eval(context).size() == 0


def test_too_near_and_too_far_depths_give_no_point(fixed_context):
    """Drake renders 0 nearer than the depth range and infinity beyond: neither is a point."""
    builder = DiagramBuilder()
    info = CameraInfo(width=3, height=2, fov_y=1.0)
    to_cloud = builder.AddSystem(DepthImageToPointCloud(info, PixelType.kDepth32F))
    segment = builder.AddSystem(SegmentPointCloud(LABEL))
    builder.Connect(to_cloud.point_cloud_output_port(), segment.GetInputPort("point_cloud"))
    builder.ExportInput(to_cloud.depth_image_input_port(), "depth")
    builder.ExportInput(to_cloud.camera_pose_input_port(), "pose")
    builder.ExportInput(segment.GetInputPort("label_image"), "label")
    builder.ExportOutput(segment.GetOutputPort("point_cloud"), "cloud")
    dut = builder.Build()
    depth = ImageDepth32F(3, 2)
    depth.mutable_data[:, :, 0] = [[0.0, 0.5, np.inf], [np.inf, 0.0, 0.0]]
    X_WC = RigidTransform([1.0, 2.0, 3.0])
    context = fixed_context(dut, depth=depth, pose=X_WC, label=label_image(np.full((2, 3), LABEL)))
    kept = dut.get_output_port().Eval(context).xyzs()
    ray = [(1 - info.center_x()) / info.focal_x(), -info.center_y() / info.focal_y(), 1.0]
    np.testing.assert_allclose(kept.T, [X_WC @ (0.5 * np.array(ray))], atol=1e-6)


def test_a_cloud_of_another_size_is_refused(fixed_context):
    dut = SegmentPointCloud(LABEL)
    context = fixed_context(
        dut, point_cloud=PointCloud(5), label_image=label_image(np.full((2, 3), LABEL))
    )
    with pytest.raises(ValueError, match="5 points but 6 labels.*same camera"):
        dut.GetOutputPort("point_cloud").Eval(context)


def square_on_a_table():
    """A square 5 cm above a table to its left and right, level with it below, nothing above.

    One pixel is 2 mm; the body's label covers rows 2 to 8, columns 3 to 9.
    """
    row, column = np.meshgrid(np.arange(10), np.arange(13), indexing="ij")
    z = np.full(row.shape, 0.5)
    body = (row >= 2) & (row <= 8) & (column >= 3) & (column <= 9)
    z[body] = 0.45
    z[9] = 0.45
    points = np.stack([0.002 * column, 0.002 * row, z]).astype(np.float32)
    points[:, :2] = np.inf
    return points, body


def kept_pixels(dut, fixed_context, points, labels):
    context = fixed_context(
        dut, point_cloud=cloud_of(points.reshape(3, -1)), label_image=label_image(labels)
    )
    xyz = dut.GetOutputPort("point_cloud").Eval(context).xyzs()
    kept = np.zeros(labels.shape, dtype=bool)
    kept[np.rint(xyz[1] / 0.002).astype(int), np.rint(xyz[0] / 0.002).astype(int)] = True
    return kept


def test_edge_pixels_are_dropped_where_the_depth_jumps(fixed_context):
    points, body = square_on_a_table()
    kept = kept_pixels(SegmentPointCloud(LABEL), fixed_context, points, np.where(body, LABEL, 3))
    expected = body.copy()
    expected[:, [3, 9]] = False  # a step down to the table
    expected[2] = False  # nothing behind
    np.testing.assert_array_equal(kept, expected)  # row 8 touches the table and stays


def test_a_hole_in_the_measurement_is_no_edge_but_a_flying_pixel_is_none_of_the_body(
    fixed_context,
):
    points, body = square_on_a_table()
    labels = np.where(body, LABEL, 3)
    before = kept_pixels(SegmentPointCloud(LABEL), fixed_context, points, labels)
    points[:, 5, 5] = np.inf
    holed = kept_pixels(SegmentPointCloud(LABEL), fixed_context, points, labels)
    assert (before & ~holed).sum() == 1
    points[:, 5, 5] = [0.010, 0.010, 0.48]
    flown = kept_pixels(SegmentPointCloud(LABEL), fixed_context, points, labels)
    assert not flown[5, 5] and (holed & ~flown).sum() == 4


def test_the_outline_is_of_what_has_no_depth_and_of_what_is_before_the_body(fixed_context):
    row, column = np.meshgrid(np.arange(40), np.arange(60), indexing="ij")
    points = np.stack([0.002 * column, 0.002 * row, np.full(row.shape, 0.5)]).astype(np.float32)
    labels = np.full(row.shape, 3)
    labels[5:30, 10:50] = LABEL
    labels[:5] = 5  # a finger
    points[:, 10:25, 20:35] = np.inf
    inputs = {"point_cloud": cloud_of(points.reshape(3, -1)), "label_image": label_image(labels)}
    camera = Camera((10.0, 10.0, 6.0, 5.0), 60, 40, 0.1, 0.0)
    dut = SegmentPointCloud(LABEL, camera=camera, hiding=[5, LABEL])
    found = dut.GetOutputPort("outline").Eval(fixed_context(dut, **inputs))
    u, v = (np.rint(each).astype(int) for each in camera.pixels(found.unmeasured))
    assert (u.min(), u.max(), v.min(), v.max()) == (21, 33, 11, 23) and len(u) == 169
    assert set(np.rint(camera.pixels(found.hidden)[1]).astype(int)) == {0, 1, 2, 3, 4}
    assert found.whole
    plain = SegmentPointCloud(LABEL)
    assert evaluate(plain.GetOutputPort("outline"), fixed_context(plain, **inputs)) is None


def test_with_the_depth_image_pixels_between_two_surfaces_are_dropped(fixed_context):
    """A ramp of three pixels from the square down to the table, flat enough to have no jump."""
    points, body = square_on_a_table()
    body[:] = True
    points[2] = 0.45
    points[2, :, 4:] = 0.45 + np.clip(0.012 * np.arange(1, 10), 0.0, 0.048)
    points[0], points[1] = 0.002 * np.arange(13), 0.002 * np.arange(10)[:, None]
    labels = np.where(body, LABEL, 3)
    camera = Camera((230.0, 230.0, 6.0, 5.0), 13, 10, 0.1, 1e-3)
    dut = SegmentPointCloud(LABEL, camera=camera, smears=True)
    before = kept_pixels(dut, fixed_context, points, labels)
    assert before.all()
    depth = ImageDepth32F(13, 10)
    depth.mutable_data[:, :, 0] = points[2]
    given = {"point_cloud": cloud_of(points.reshape(3, -1)), "label_image": label_image(labels)}
    context = fixed_context(dut, **given, depth_image=depth)
    xyz = dut.GetOutputPort("point_cloud").Eval(context).xyzs()
    columns = np.unique(np.rint(xyz[0] / 0.002).astype(int))
    np.testing.assert_array_equal(columns, [0, 1, 2, 3, 7, 8, 9, 10, 11, 12])
