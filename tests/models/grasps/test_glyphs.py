"""Glyphs against trimesh, Drake's transforms and the gripper's own collision geometry."""

import numpy as np
import pytest
import trimesh
from pydrake.math import RigidTransform, RollPitchYaw

from feasigrasp.models.grasps.glyphs import (
    disc,
    frames_along,
    gripper_glyph,
    place_copies,
    spread_order,
)
from feasigrasp.models.robot.gripper import ParallelGripper

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def random_poses(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array(
        [
            RigidTransform(
                RollPitchYaw(rng.uniform(-3, 3, 3)), rng.uniform(-0.1, 0.1, 3)
            ).GetAsMatrix4()
            for _ in range(n)
        ]
    )


@pytest.mark.parametrize("opening", [0.085, 0.12])
def test_fork_stands_where_the_open_hand_would(opening: float) -> None:
    gripper = ParallelGripper(max_opening=opening)
    parts = trimesh.Trimesh(*gripper_glyph(gripper)).split()
    fingers = sorted((p for p in parts if p.bounds[1, 2] > 0), key=lambda p: p.centroid[0])
    handle = [p for p in parts if p.bounds[1, 2] <= 0]
    assert len(fingers) == len(handle) == 2

    # The pads' inner faces and the tips are where the gripper has them, centred on the origin.
    (left, right) = (finger.bounds for finger in fingers)
    assert right[0, 0] - left[1, 0] == pytest.approx(opening)
    assert right[0, 0] == pytest.approx(-left[1, 0])
    hand = gripper.surface_points(opening)
    assert left[1, 2] == right[1, 2] == pytest.approx(hand[:, 2].max())

    # The rest lies behind the fingers against the approach direction; nothing is in front.
    for part in handle:
        assert part.bounds[1, 2] <= gripper.heel + 0.01
        np.testing.assert_allclose(part.centroid[:2], 0.0, atol=1e-12)
    assert min(part.bounds[0, 2] for part in handle) < gripper.heel - 0.02


def test_rods_are_solids_with_outward_faces() -> None:
    parts = trimesh.Trimesh(*gripper_glyph(ParallelGripper())).split(only_watertight=False)
    assert len(parts) == 4
    for part in parts:
        assert part.is_watertight
        assert part.volume == pytest.approx(np.prod(part.extents))


def test_copies_are_placed_by_their_poses() -> None:
    poses = random_poses(5)
    vertices, faces = gripper_glyph(ParallelGripper())
    placed, all_faces = place_copies(poses, vertices, faces)
    expected = np.concatenate([(RigidTransform(X) @ vertices.T).T for X in poses])
    np.testing.assert_allclose(placed, expected, atol=1e-12)
    one, many = trimesh.Trimesh(vertices, faces), trimesh.Trimesh(placed, all_faces)
    assert many.volume == pytest.approx(5 * one.volume)
    assert many.area == pytest.approx(5 * one.area)


def test_no_poses_make_an_empty_mesh() -> None:
    placed, faces = place_copies(np.zeros((0, 4, 4)), *gripper_glyph(ParallelGripper()))
    assert placed.shape == (0, 3)
    assert faces.shape == (0, 3)


def test_discs_face_along_the_normals() -> None:
    rng = np.random.default_rng(1)
    normals = np.concatenate([rng.normal(size=(20, 3)), np.eye(3), -np.eye(3)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = rng.normal(size=normals.shape)
    frames = frames_along(points, normals)
    np.testing.assert_allclose(np.linalg.det(frames[:, :3, :3]), 1.0)
    shape = disc(0.01)
    mesh = trimesh.Trimesh(*place_copies(frames, *shape), process=False)
    per_disc = len(shape[1])
    np.testing.assert_allclose(mesh.face_normals, np.repeat(normals, per_disc, axis=0), atol=1e-6)
    centres = mesh.vertices.reshape(len(points), -1, 3).mean(axis=1)
    np.testing.assert_allclose(centres, points, atol=1e-12)


def test_spread_order_starts_with_the_best_and_ends_with_repetitions() -> None:
    poses = random_poses(6)
    poses = np.concatenate([poses, poses[2:3] @ FLIP, poses[4:5]])
    order = spread_order(poses, np.linspace(0.1, 0.8, len(poses))[::-1])
    assert sorted(order) == list(range(len(poses)))
    assert order[0] == 0
    # A flip and a copy show nothing new: one of either pair comes last.
    assert {frozenset((2, 6)), frozenset((4, 7))} == {
        next(pair for pair in (frozenset((2, 6)), frozenset((4, 7))) if i in pair)
        for i in order[-2:]
    }
    assert len(spread_order(np.zeros((0, 4, 4)), [])) == 0
