"""Rays and distances against the closed forms of a box."""

import numpy as np
import pytest
import trimesh

from feasigrasp_lab.training.data.raycasting import Raycaster

HALF = np.array([0.03, 0.04, 0.05])
POINTS = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3))


@pytest.fixture(scope="module")
def box():
    mesh = trimesh.creation.box(2 * HALF)
    return Raycaster(mesh.vertices, mesh.faces)


def test_distances_are_those_of_the_box(box):
    q = np.abs(POINTS) - HALF
    signed = np.linalg.norm(np.maximum(q, 0.0), axis=1) + np.minimum(q.max(axis=1), 0.0)
    np.testing.assert_allclose(box.signed_distance(POINTS), signed, atol=1e-7)
    np.testing.assert_allclose(box.distance(POINTS), np.abs(signed), atol=1e-7)
    np.testing.assert_array_equal(box.inside(POINTS), signed < 0.0)
    outside = signed > 0.0
    at, face = box.closest(POINTS[outside])
    np.testing.assert_allclose(at, np.clip(POINTS[outside], -HALF, HALF), atol=1e-7)
    assert face.max() < 12


def test_rays_end_at_the_first_face_or_never(box):
    starts = np.array([[-0.1, 0.01, 0.02], [-0.1, 0.05, 0.0], [0.0, 0.0, 0.0]])
    length, face = box.cast(starts, np.tile([1.0, 0.0, 0.0], (3, 1)))
    np.testing.assert_allclose(length, [0.07, np.inf, 0.03], atol=1e-7)
    np.testing.assert_array_equal(face < 12, [True, False, True])


def test_a_depth_image_shows_the_front(box):
    K, X_CO = np.array([[100.0, 0, 20], [0, 100, 15], [0, 0, 1]]), np.eye(4)
    X_CO[2, 3] = 0.5
    depth = box.depth_image(K, X_CO, 40, 30)
    assert depth.shape == (30, 40)
    np.testing.assert_allclose(depth[np.isfinite(depth)], 0.45, atol=1e-6)
    column, row = (np.flatnonzero(np.isfinite(depth).any(axis=axis)) for axis in (0, 1))
    assert len(column) == 14 and len(row) == 18  # 6 cm and 8 cm at 45 cm
