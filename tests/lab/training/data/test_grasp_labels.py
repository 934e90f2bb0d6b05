"""Labels against closed forms: box, sphere, cylinder."""

import numpy as np
import pytest
import trimesh

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.training.data.grasp_labels import (
    N_TURNS,
    SLACK,
    find_labels,
)
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps

GRIPPER = ParallelGripper()
TWIN = np.diag([-1.0, -1.0, 1.0, 1.0])


def labels_of(mesh, points, normals, seed=0):
    rng = np.random.default_rng(seed)
    return find_labels(TrueGrasps(mesh), points, normals, GRIPPER, rng)


def surface(mesh, count, seed=0):
    points, faces = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.asarray(points), np.asarray(mesh.face_normals[faces])


def turned(closing, across):
    """Approach directions of all turns, shape (N_TURNS, 3)."""
    t = 2 * np.pi * np.arange(N_TURNS)[:, None] / N_TURNS
    return np.cos(t) * across + np.sin(t) * np.cross(closing, across)


@pytest.fixture(scope="module")
def box():
    mesh = trimesh.creation.box((0.04, 0.12, 0.12))
    return mesh, *surface(mesh, 300)


def test_box_is_grasped_across_its_narrow_side_only(box):
    mesh, points, normals = box
    labels = labels_of(mesh, points, normals)
    narrow = np.abs(normals[:, 0]) > 0.5
    assert not labels.contact[~narrow].any()
    reachable = narrow & (np.abs(points[:, 1:]).max(axis=1) > 0.03)
    assert labels.contact[reachable].mean() > 0.95
    # The middle of a face is 60 mm from every edge, the palm 50 mm from the pads.
    middle = narrow & (np.abs(points[:, 1:]).max(axis=1) < 0.005)
    assert not labels.contact[middle].any()
    found = labels.contact
    np.testing.assert_allclose(labels.width[found], 0.04, atol=1e-3)
    cosine = -np.einsum("ij,ij->i", labels.closing[found], normals[found])
    assert cosine.min() > 0.99


def test_box_is_approached_from_its_near_edge(box):
    """In the middle of a side the palm, 50 mm behind the pads, leaves no way but from above."""
    points = np.array([[0.02, y, 0.05] for y in np.linspace(-0.005, 0.005, 5)])
    labels = labels_of(box[0], points, np.tile([1.0, 0.0, 0.0], (5, 1)))
    assert labels.contact.all()
    for row in range(5):
        approach = turned(labels.closing[row], labels.across[row])[labels.free[row]]
        assert len(approach) >= 5
        assert approach[:, 2].max() < 0.0
        np.testing.assert_allclose(approach @ labels.closing[row], 0.0, atol=1e-6)


def test_ball_is_grasped_everywhere_from_everywhere():
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    labels = labels_of(mesh, *surface(mesh, 100))
    assert labels.contact.all()
    assert labels.free.all()
    np.testing.assert_allclose(labels.width, 0.06, atol=1.5e-3)


@pytest.mark.parametrize("radius, graspable", [(0.038, True), (0.043, False)])
def test_width_limit_of_a_cylinder(radius, graspable):
    assert (2 * radius <= GRIPPER.max_opening - SLACK) == graspable
    mesh = trimesh.creation.cylinder(radius=radius, height=0.15, sections=64)
    points, normals = surface(mesh, 200)
    wall = np.abs(normals[:, 2]) < 0.1
    labels = labels_of(mesh, points[wall], normals[wall])
    assert labels.contact.mean() > 0.5 if graspable else not labels.contact.any()


def test_invented_and_turned_points_are_no_contacts(box):
    mesh, points, normals = box
    assert not labels_of(mesh, points + 0.006 * normals, normals).contact.any()
    side = np.roll(normals, 1, axis=1)
    assert not labels_of(mesh, points, side).contact.any()


def test_every_label_is_a_valid_grasp():
    """Poses made from labels pass the exact test, with the camera on one side or the other."""
    mug = trimesh.creation.annulus(r_min=0.046, r_max=0.050, height=0.09)
    truth = TrueGrasps(mug)
    points, normals = surface(mug, 300)
    labels = find_labels(truth, points, normals, GRIPPER, np.random.default_rng(0))
    found = np.flatnonzero(labels.contact)
    assert len(found) > 50
    poses = np.tile(np.eye(4), (len(found), 1, 1))
    poses[:, :3, 0] = labels.closing[found]
    for pose, row in zip(poses, found, strict=True):
        approaches = turned(labels.closing[row], labels.across[row])
        pose[:3, 2] = approaches[np.argmax(labels.free[row])]
    poses[:, :3, 1] = np.cross(poses[:, :3, 2], poses[:, :3, 0])
    middle = 0.5 * labels.width[found, None] * labels.closing[found]
    poses[:, :3, 3] = truth.closest(points[found])[0] + middle
    assert (truth.valid(poses, GRIPPER) | truth.valid(poses @ TWIN, GRIPPER)).all()
    # Its wall of 4 mm can be pinched, and nothing else.
    np.testing.assert_allclose(labels.width[found], 0.004, atol=5e-4)
