"""The cell's camera against the true surface of the object and Drake's kinematics."""

import numpy as np
import open3d as o3d
import pytest
from pydrake.math import RigidTransform

from feasigrasp.scenario.sampling import load_scenario_object
from tests.cell import HOME


@pytest.fixture(scope="module")
def surface(seeing):
    """Distance of points in O to the object's true surface."""
    obj = load_scenario_object(seeing.scenario)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(obj.vertices.astype(np.float32)),
        o3d.core.Tensor(obj.faces.astype(np.uint32)),
    )
    return lambda x: scene.compute_distance(o3d.core.Tensor(x.astype(np.float32))).numpy()


def test_the_point_cloud_lies_on_the_true_object(seeing, surface):
    cell = seeing.start()
    cell.advance(0.01)
    labels = cell.read("wrist_camera.label_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    on_object = labels == int(cell.station.object_body.index())
    assert on_object.sum() > 500
    points = xyz[:, on_object]
    assert np.isfinite(points).all()
    distance = surface((cell.object_pose().inverse() @ points).T)
    assert distance.max() < 1e-5  # half a pixel would be 5e-4


def test_no_other_label_lies_on_the_object(seeing, surface):
    """A label is the index of a body: all that touches the object's surface bears its own."""
    cell = seeing.start()
    cell.advance(0.01)
    labels = cell.read("wrist_camera.label_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    others = np.isfinite(xyz).all(axis=0) & (labels != int(cell.station.object_body.index()))
    assert others.sum() > 500
    assert surface((cell.object_pose().inverse() @ xyz[:, others]).T).min() > 2e-3
    bodies = cell.station.plant.num_bodies()
    assert np.all(labels[others] < bodies)


def test_an_object_nearer_than_the_depth_range_has_labels_but_no_points(seeing):
    cell = seeing.start()
    X_WC = cell.read("wrist_camera.pose")
    z_near = cell.scenario.cameras["wrist_camera"].z_near
    cell.put_object(X_WC @ RigidTransform([0.0, 0.0, z_near - 0.05]))
    labels = cell.read("wrist_camera.label_image").data.ravel()
    depth = cell.read("wrist_camera.depth_image").data.ravel()
    xyz = cell.read("wrist_camera.point_cloud").xyzs()
    too_near = (labels == int(cell.station.object_body.index())) & (depth == 0.0)
    assert too_near.sum() > 500
    assert not np.isfinite(xyz[:, too_near]).any(axis=0).any()


def test_the_camera_moves_with_the_hand(seeing):
    """Its pose against Drake's own kinematics, and the object in the middle of its picture."""
    cell = seeing.start()
    plant = cell.station.plant
    frame = plant.GetFrameByName("camera_optical")
    for q in (HOME, HOME + 0.1):
        context = plant.GetMyMutableContextFromRoot(cell.context)
        plant.SetPositions(context, plant.GetModelInstanceByName("iiwa"), q)
        X_WC = cell.read("wrist_camera.pose").GetAsMatrix4()
        expected = frame.CalcPoseInWorld(context).GetAsMatrix4()
        np.testing.assert_allclose(X_WC, expected, atol=1e-12)
    assert X_WC[2, 3] > 0.3
