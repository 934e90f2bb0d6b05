"""What is seen beside the object: where it is, and that it holds the object without being in it."""

import numpy as np
import open3d as o3d
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.distractor_bodies import (
    WITHDRAWAL,
    CarrierKind,
    make_carrier,
    make_distractor,
)
from feasigrasp.models.objects.motion import HarmonicMotion
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object

CASES = [(name, seed) for seed, name in enumerate(builtin_objects())]


def motion(seed=0):
    """A line along y with a turn about z, of an object that starts in any orientation."""
    R_WO = Rotation.random(random_state=seed).as_matrix()
    along = ([0.5, 0.0, 0.55], [0.0, 0.18, 0.0], np.ones(3), np.zeros(3))
    return HarmonicMotion(*along, 0.6, 0.3, [0.0, 0.0, 1.0], 0.2, R_WO)


def carrier(kind, name="mug", seed=0):
    obj, path = load_object(name), motion(seed)
    return obj, path, make_carrier(kind, obj, path, None)


def moved(points, X):
    return points @ X[:3, :3].T + X[:3, 3]


def depths(points, vertices, faces):
    """How deep points are inside a closed surface, by Open3D; negative outside [m]."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(vertices.astype(np.float32), faces.astype(np.uint32))
    return -scene.compute_signed_distance(points.astype(np.float32)).numpy()


@pytest.mark.parametrize(("name", "seed"), CASES)
def test_a_hand_holds_the_far_end_and_is_not_in_the_object(name, seed):
    obj, path, hand = carrier(CarrierKind.HAND, name, seed)
    surface_W = moved(obj.vertices, path.pose(0.0))
    hand_W = trimesh.Trimesh(moved(hand.mesh.vertices, hand.pose(0.0, 0.0)), hand.mesh.faces)
    reach = surface_W[:, 0].max() - hand_W.vertices[:, 0].min()
    assert 0.0 < reach < min(0.0301, 0.36 * np.ptp(surface_W[:, 0]))
    points, _ = trimesh.sample.sample_surface(hand_W, 1500, seed=0)
    depth = depths(points, surface_W, obj.faces)
    assert depth.max() < 0.001
    # Thumb and fingers stand on both sides of what they hold, and one of them touches it.
    held = surface_W[surface_W[:, 0] >= surface_W[:, 0].max() - reach, 1].mean()
    assert hand_W.vertices[:, 1].min() < held < hand_W.vertices[:, 1].max()
    assert depth.max() > -0.005


@pytest.mark.parametrize(("name", "seed"), CASES[::3])
def test_a_belt_is_under_the_object_however_it_turns(name, seed):
    obj, path, belt = carrier(CarrierKind.BELT, name, seed)
    for t in (0.0, 1.0, 7.0):
        surface_W = moved(obj.vertices, path.pose(t))
        belt_W = moved(belt.mesh.vertices, belt.pose(t, 0.0))
        gap = surface_W[:, 2].min() - belt_W[:, 2].max()
        assert 0.0 < gap < 0.002
        assert np.ptp(belt_W[:, 2]) == pytest.approx(0.01)


@pytest.mark.parametrize("kind", [CarrierKind.HAND, CarrierKind.BELT])
def test_it_goes_with_the_object_and_draws_back_from_it_when_it_has_let_go(kind):
    _, path, body = carrier(kind)
    carried = [np.linalg.solve(path.pose(t), body.pose(t, 0.0)) for t in (0.0, 2.0, 5.0)]
    X_OC = se3.make_pose(path.pose(0.0)[:3, :3].T, np.zeros(3))
    np.testing.assert_allclose(carried, [X_OC] * 3, atol=1e-12)
    away = [body.pose(3.0, since)[:3, 3] - path.pose(3.0)[:3, 3] for since in (0.0, 0.5, 1.0, 9.0)]
    distance = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(distance, [0.0, 0.15, 0.3, WITHDRAWAL], atol=1e-12)
    if kind is CarrierKind.BELT:
        np.testing.assert_allclose(away[-1], [0.0, 0.0, -WITHDRAWAL], atol=1e-12)
    else:  # away from the arm
        assert away[-1][0] > 0.5 * WITHDRAWAL


def test_another_object_moves_beside_the_object_or_rests():
    path, apple, offset = motion(), load_object("apple"), np.array([0.0, 0.1, 0.1])
    for moving, expected in (
        (True, path.pose(2.0)[:3, 3] + offset),
        (False, offset),
    ):
        body = make_distractor(apple, path, offset, moving)
        X_WC = body.pose(2.0, 0.0)
        np.testing.assert_allclose(X_WC[:3, 3], expected)
        np.testing.assert_array_equal(X_WC[:3, :3], np.eye(3))
