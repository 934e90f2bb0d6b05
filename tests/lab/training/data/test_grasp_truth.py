"""Validity of grasps on meshes whose answer is known in closed form."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps, hand_boxes, surface_samples

GRIPPER = ParallelGripper()
OPEN = GRIPPER.max_opening


def frame(x, z, origin=(0.0, 0.0, 0.0)):
    X = np.eye(4)
    X[:3, 0], X[:3, 2], X[:3, 3] = x, z, origin
    X[:3, 1] = np.cross(z, x)
    return X


@pytest.fixture(scope="module")
def box():
    return TrueGrasps(trimesh.creation.box((0.05, 0.10, 0.16)))


def test_pads_meet_the_faces_of_a_box(box):
    closed = box.close(frame([1, 0, 0], [0, 0, -1], [0.003, 0.02, 0.07]), OPEN)
    assert closed.width[0] == pytest.approx(0.05, abs=1e-6)
    np.testing.assert_allclose(closed.first, [[-0.025, 0.02, 0.07]], atol=1e-6)
    assert closed.cosine[0] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("tilt, antipodal", [(0, True), (19, True), (21, False), (-19, True)])
def test_friction_cone_of_parallel_faces(box, tilt, antipodal):
    t = np.deg2rad(tilt)
    X = frame([np.cos(t), np.sin(t), 0], [0, 0, -1])
    assert box.truly_antipodal(X, OPEN)[0] == antipodal


def test_line_past_the_object_is_no_grasp(box):
    assert not box.truly_antipodal(frame([1, 0, 0], [0, 0, -1], [0, 0, 0.2]), OPEN)[0]


def test_too_wide_for_the_hand(box):
    # Across the 10 cm, either pad starts inside.
    X = frame([0, 1, 0], [0, 0, -1], [0, 0, 0.07])
    assert not box.valid(X, GRIPPER)[0]


def test_chord_of_a_sphere_off_its_centre():
    truth = TrueGrasps(trimesh.creation.icosphere(subdivisions=5, radius=0.03))
    offset = 0.03 * np.sin(np.deg2rad([10.0, 25.0]))
    poses = [frame([1, 0, 0], [0, 0, -1], [0, 0, z]) for z in offset]
    closed = truth.close(poses, OPEN)
    np.testing.assert_allclose(closed.width, 2 * np.sqrt(0.03**2 - offset**2), atol=1e-4)
    np.testing.assert_allclose(closed.cosine, np.cos(np.deg2rad([10.0, 25.0])), atol=0.02)
    assert truth.truly_antipodal(poses, OPEN).tolist() == [True, False]


@pytest.mark.parametrize(
    "z, free",
    [
        (0.08, True),  # pads at the upper edge
        (0.031, True),  # the palm just above it: 50 mm behind the pads
        (0.029, False),  # the palm in it
    ],
)
def test_palm_above_a_box(box, z, free):
    assert box.hand_free(frame([1, 0, 0], [0, 0, -1], [0, 0, z]), GRIPPER)[0] == free


def test_fingers_beside_a_box(box):
    # 85 mm open, 50 mm wide: 17.5 mm of room on either side.
    for shift, free in ((0.0, True), (0.017, True), (0.018, False)):
        X = frame([1, 0, 0], [0, 0, -1], [shift, 0, 0.07])
        assert box.hand_free(X, GRIPPER)[0] == free


def test_camera_counts_and_its_twin_does_not():
    """A post beside the hand where its camera is: free on the other side only."""
    camera = np.array(GRIPPER.camera_center)
    ball = trimesh.creation.icosphere(radius=0.02)
    post = trimesh.creation.cylinder(radius=0.01, height=0.05)
    post.apply_translation(camera)
    truth = TrueGrasps(trimesh.util.concatenate([ball, post]))
    twin = np.diag([-1.0, -1.0, 1.0, 1.0])
    assert truth.hand_free([np.eye(4), twin], GRIPPER).tolist() == [False, True]


def test_hand_inside_a_solid_is_not_free():
    block = TrueGrasps(trimesh.creation.box((0.9, 0.9, 0.9)))
    assert not block.hand_free(np.eye(4), GRIPPER)[0]


def test_hand_against_the_volumes_of_posed_boxes():
    """Random poses: the same verdict as exact box-against-points in trimesh."""
    rng = np.random.default_rng(0)
    mesh = trimesh.creation.capsule(height=0.08, radius=0.025)
    truth = TrueGrasps(mesh)
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, :3] = Rotation.random(60, random_state=1).as_matrix()
    poses[:, :3, 3] = rng.uniform(-0.05, 0.05, (60, 3))
    free = truth.hand_free(poses, GRIPPER)
    points = np.vstack([surface_samples(mesh, 0.002), mesh.vertices])
    expected = []
    for X in poses:
        local = (points - X[:3, 3]) @ X[:3, :3]
        inside = [
            ((low <= local) & (local <= high)).all(axis=1).any()
            for low, high in hand_boxes(GRIPPER)
        ]
        expected.append(not any(inside))
    assert 5 < sum(expected) < 55
    # Points are no surface: a corner of a box may poke in between them.
    assert np.mean(free == np.array(expected)) > 0.98


def test_verdicts_move_with_the_object():
    mesh = trimesh.creation.box((0.05, 0.06, 0.16))
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, :3, :3] = Rotation.random(40, random_state=2).as_matrix()
    poses[:, :3, 3] = rng.uniform(-0.04, 0.04, (40, 3))
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = Rotation.random(random_state=5).as_matrix(), [0.3, -0.2, 0.1]
    moved = TrueGrasps(mesh.copy().apply_transform(X))
    still = TrueGrasps(mesh)
    same = moved.truly_antipodal(X @ poses, OPEN) == still.truly_antipodal(poses, OPEN)
    same &= moved.hand_free(X @ poses, GRIPPER) == still.hand_free(poses, GRIPPER)
    assert same.mean() >= 0.975  # a marginal one may turn over in float32


def test_samples_leave_no_gap():
    mesh = trimesh.creation.box((0.05, 0.10, 0.16))
    samples = surface_samples(mesh, 0.003)
    probes, _ = trimesh.sample.sample_surface(mesh, 500, seed=0)
    apart = np.linalg.norm(probes[:, None] - samples[None], axis=2).min(axis=1)
    assert apart.max() < 0.003
    outside = np.abs(samples) / mesh.extents * 2  # on a face one of the ratios is 1
    np.testing.assert_allclose(outside.max(axis=1), 1.0, atol=1e-9)
