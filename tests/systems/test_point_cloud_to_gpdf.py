"""Perception merges views in the object frame, at its rate, and survives views without content."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.perception import PointCloud

from feasigrasp.errors import PointCloudError
from feasigrasp.models.clouds.checks import ViewFault
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.systems import point_cloud_to_gpdf
from feasigrasp.systems.point_cloud_to_gpdf import PointCloudToGPDF
from tests.perception_bench import CAMERA, POSES, RADIUS, Perception, seen_from, sphere


def test_ports_are_those_of_the_docstring(ports, documented_ports):
    inputs, outputs = ports(PointCloudToGPDF())
    assert (list(inputs), list(outputs)) == documented_ports(PointCloudToGPDF)


def test_nothing_seen_yet_is_none():
    perception = Perception()
    assert perception.gpdf() is None


@pytest.mark.parametrize("X_WO", POSES[1:])
def test_the_field_does_not_depend_on_the_pose_of_the_object(X_WO):
    fields, clouds = [], []
    for pose in (POSES[0], X_WO):
        perception = Perception()
        clouds.append(perception.see_object(0.1, pose).cloud)
        fields.append(perception.gpdf())
    # Drake's clouds are float32: half a micrometre at two metres.
    np.testing.assert_allclose(clouds[1].points, clouds[0].points, atol=1e-6)
    np.testing.assert_allclose(clouds[1].directions, clouds[0].directions, atol=1e-4)
    x = 0.08 * np.random.default_rng(1).normal(size=(200, 3))
    np.testing.assert_allclose(fields[1].distance(x), fields[0].distance(x), atol=2e-5)
    assert np.ptp(fields[0].distance(x)) > 0.02


def test_views_of_a_turning_object_complete_it():
    far_side = seen_from(sphere(seed=5), -CAMERA)
    perception = Perception()
    one = perception.see_object(0.1, POSES[1])
    error_of_one = np.abs(perception.gpdf().refine(far_side)[0]).mean()
    # The object has turned: the same camera now sees the other side of it.
    two = perception.see_object(0.6, POSES[2], p_OC=-CAMERA)
    error_of_two = np.abs(perception.gpdf().refine(far_side)[0]).mean()
    assert (one.cloud.views, two.cloud.views) == (1, 2)
    assert one.cloud.points[:, 2].min() > 0.0 > -0.02 > two.cloud.points[:, 2].min()
    assert error_of_two < 0.001 < 0.0025 < error_of_one
    np.testing.assert_allclose(np.linalg.norm(two.cloud.points, axis=1), RADIUS, atol=1e-3)


def test_directions_point_to_the_camera_of_their_view():
    perception = Perception()
    cloud = perception.see_object(0.1, POSES[1], p_OC=np.array([0.3, -0.2, 0.4])).cloud
    expected = np.array([0.3, -0.2, 0.4]) - cloud.points
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(cloud.directions, expected, atol=1e-3)


NAN_POSE = RigidTransform(np.full((4, 4), np.nan))
#: Points in W, pose of the object, and the fault; None for a view that does not show the object.
BLIND = {
    "empty": (np.zeros((0, 3)), POSES[0], None),
    "too few points": (sphere(31), POSES[0], None),
    "all NaN": (np.full((500, 3), np.nan), POSES[0], ViewFault.NOT_FINITE),
    "all infinite": (np.full((500, 3), np.inf), POSES[0], ViewFault.NOT_FINITE),
    "one coordinate NaN": (
        np.where([True, True, False], sphere(), np.nan),
        POSES[0],
        ViewFault.NOT_FINITE,
    ),
    "pose NaN": (sphere(), NAN_POSE, ViewFault.UNKNOWN_POSE),
    "a spot": (np.full((500, 3), 0.1), POSES[0], ViewFault.NO_SURFACE),
    "a line": (np.outer(np.linspace(0, 0.1, 500), [0, 0, 1.0]), POSES[0], ViewFault.NO_SURFACE),
    "metres wide": (sphere() * 60.0, POSES[0], ViewFault.TOO_WIDE),
}


@pytest.mark.parametrize("case", BLIND)
def test_a_view_that_cannot_be_used_changes_nothing_and_is_counted(case):
    points, pose, fault = BLIND[case]
    perception = Perception()
    blind = perception.look(0.1, points, pose)
    assert perception.gpdf() is None
    assert blind.faults == ({} if fault is None else {fault: 1})
    assert perception.view_faults() == (fault is not None)
    before = perception.see_object(0.6, POSES[1])
    field = perception.gpdf()
    assert field is not None
    assert before.cloud.views == 1
    after = perception.look(1.1, points, pose)
    if case in ("a spot", "a line"):  # beside a surface seen before they are points like others
        return
    assert after.cloud is before.cloud and after.views is before.views
    assert perception.gpdf() is field
    assert perception.view_faults() == 2 * (fault is not None)
    assert after.last_fault.startswith(fault or "")


def test_whatever_the_fit_raises_is_counted(monkeypatch):
    def broken(*args, **kwargs):
        raise np.linalg.LinAlgError("singular matrix")

    perception = Perception()
    monkeypatch.setattr(point_cloud_to_gpdf, "complete_shape", broken)
    perception.see_object(0.1, POSES[1])
    seen = perception.see_object(0.6, POSES[1])
    assert seen.faults == {ViewFault.NO_FIELD: 2}
    assert seen.last_fault == "no field fits: singular matrix"
    assert perception.view_faults() == 2
    monkeypatch.undo()
    assert perception.see_object(1.1, POSES[1]).gpdf is not None


def test_outliers_are_dropped_and_counted():
    visible = seen_from(sphere(3000), CAMERA)
    rng = np.random.default_rng(1)
    stray = visible[:100] + rng.uniform(-0.05, 0.05, (100, 3)) + [0.0, 0.0, 0.06]
    clean, dirty = Perception(), Perception()
    expected = clean.look(0.1, visible)
    found = dirty.look(0.1, np.concatenate([visible, stray]))
    assert expected.outliers < 5 and 80 < found.outliers < 120
    np.testing.assert_allclose(
        np.ptp(found.cloud.points, 0), np.ptp(expected.cloud.points, 0), atol=0.006
    )


def test_the_time_of_the_last_view_is_told():
    """Of one that was merged: not of one that showed nothing, nor of one that was not looked at."""
    perception = Perception(period=0.5, views_per_side=2)

    def view_time():
        return perception.dut.GetOutputPort("view_time").Eval(perception.context)[0]

    assert np.isnan(view_time())
    perception.look(0.4, np.zeros((0, 3)))  # nothing at 0
    assert np.isnan(view_time())
    perception.see_object(0.9, POSES[1])  # at 0.5
    assert view_time() == 0.5
    perception.see_object(1.4, POSES[1])  # at 1, the second of this side
    assert view_time() == 1.0
    perception.see_object(1.9, POSES[1])  # the side is known
    assert view_time() == 1.0
    perception.see_object(2.4, POSES[2], p_OC=-CAMERA)  # another side, at 2
    assert view_time() == 2.0


def test_invalid_points_are_left_out():
    visible = seen_from(sphere(), CAMERA)
    mixed = np.concatenate([visible, np.full((50, 3), np.inf), np.full((50, 3), np.nan)])
    clean, dirty = Perception().look(0.1, visible), Perception().look(0.1, mixed)
    np.testing.assert_array_equal(dirty.cloud.points, clean.cloud.points)


@pytest.mark.parametrize("period", [0.5, 0.2])
def test_it_looks_exactly_once_per_period(monkeypatch, period):
    perception = Perception(period=period, views_per_side=100)
    looked, fit = [], point_cloud_to_gpdf.complete_shape

    def counting(*args, **kwargs):
        looked.append(perception.context.get_time())
        return fit(*args, **kwargs)

    monkeypatch.setattr(point_cloud_to_gpdf, "complete_shape", counting)
    visible = seen_from(sphere(), CAMERA)
    for k in range(1, 20):
        perception.look(0.1 * k + 0.05, visible)
        perception.gpdf()
    # 1.95 s in all.
    np.testing.assert_allclose(looked, np.arange(0.0, 1.95, period), atol=1e-9)


def test_it_looks_no_more_where_it_has_seen_enough():
    """Until something may have changed; another side is looked at at once."""
    perception = Perception(period=0.5, views_per_side=3, revisit=2.0)
    counts, fields = [], []
    for k in range(8):  # views at 0, 0.5, 1.0; then not before 3.0
        counts.append(perception.see_object(0.5 * k + 0.1, POSES[1]).cloud.views)
        fields.append(perception.gpdf())
    assert counts == [1, 2, 3, 3, 3, 3, 4, 4]
    assert fields[3] is fields[2] is fields[5] and fields[6] is not fields[5]
    aside = np.array([0.0, 0.15, 0.45])  # 18 degrees
    assert perception.see_object(4.1, POSES[1], p_OC=aside).cloud.views == 5
    near = 0.6 * aside
    assert [
        perception.see_object(4.6 + 0.5 * k, POSES[1], p_OC=near).cloud.views for k in range(4)
    ] == [6, 7, 8, 8]


def test_what_brings_nothing_new_is_not_even_rendered():
    """The cloud is not asked for."""
    perception = Perception(period=0.5, views_per_side=1, check=10.0)
    seen = perception.see_object(0.1, POSES[1])
    perception.dut.GetInputPort("point_cloud").FixValue(perception.context, PointCloud(7))
    read = []
    perception.dut._cloud = type("Port", (), {"Eval": lambda self, context: read.append(1)})()
    perception.simulator.AdvanceTo(2.1)
    assert read == []
    assert perception.dut.GetOutputPort("perceived").Eval(perception.context) is seen


def test_the_options_reach_the_fit():
    perception = Perception(max_points=100, length_scale=0.2)
    perception.look(0.1, sphere())
    assert len(perception.gpdf().points) == 100
    assert perception.gpdf().length_scale == 0.2


def test_the_paper_preset_merges_plainly_and_fits_the_papers_field():
    visible = seen_from(sphere(), CAMERA)
    perception = Perception(preset="paper", max_points=100)
    cloud = perception.look(0.1, visible).cloud
    expected = FusedCloud.empty(0.003).merged(visible, CAMERA)
    np.testing.assert_allclose(cloud.points, expected.points, atol=1e-6)
    assert perception.gpdf().nodes.shape == (3, 100)  # nothing beside the points


def test_the_completion_stays_out_of_free_space():
    perception = Perception()
    perception.look(0.1, seen_from(sphere(4000), CAMERA))
    points = perception.gpdf().completion.points
    across = np.linalg.norm(points[:, :2], axis=1)
    assert len(points) > 300
    assert across.max() < RADIUS + 0.006
    assert points[:, 2].min() < -0.01  # and yet it closes the hidden side


def test_an_unknown_preset_is_refused():
    with pytest.raises(PointCloudError, match="'fast'.*choose one of default, paper"):
        PointCloudToGPDF(preset="fast")


@pytest.mark.parametrize("X_WO", POSES)
def test_the_outline_is_turned_into_the_frame_of_the_object(X_WO):
    """What the camera says of its own axes is where the object is, whatever its pose."""
    perception = Perception(period=0.1)
    whole = seen_from(sphere(3000), CAMERA)
    band = np.abs(whole[:, 0]) < 0.012
    R_WC = RollPitchYaw(0.4, -0.3, 1.0).ToRotationMatrix()
    X_WC = RigidTransform(R_WC, X_WO @ CAMERA)
    rays_C = (X_WC.inverse() @ (X_WO @ whole[band].T)).T
    perception.dut.GetInputPort("outline").FixValue(
        perception.context, Value[object](Outline(rays_C, []))
    )
    seen = perception.look(0.05, (X_WO @ whole[~band].T).T, X_WO, X_WC)
    (image,) = seen.cloud.images
    row, column, _, inside = image.project(whole[band])
    assert inside.all() and (image.unclear | image.mask)[row, column].all()
    assert image.unclear.any()
