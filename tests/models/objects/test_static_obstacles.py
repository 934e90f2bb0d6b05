"""How far static obstacles are, against the distances of their triangles."""

import numpy as np
import open3d as o3d
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from feasigrasp.errors import MeshError
from feasigrasp.models.control.planning.static_grid import nearest_of, static_grid
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.mesh import read_surface
from feasigrasp.models.objects.static_obstacles import StaticObstacle

POSE = se3.make_pose(
    Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix(), [0.5, 0.1, 0.4]
)


def tray(folder):
    """A file with a tray of a floor and two walls [mm], which is hollow."""
    parts = [trimesh.creation.box((300, 200, 10))]
    for x in (-145, 145):
        parts.append(trimesh.creation.box((10, 200, 100)).apply_translation((x, 0, 50)))
    trimesh.util.concatenate(parts).export(folder / "tray.stl")
    return folder / "tray.stl"


@pytest.fixture(params=["box", "tray", "ball"])
def obstacle(request, tmp_path):
    if request.param == "box":
        return StaticObstacle.box("box", [0.3, 0.2, 0.1], POSE)
    if request.param == "tray":
        return StaticObstacle("tray", read_surface(tray(tmp_path), 0.001), POSE)
    return StaticObstacle("ball", trimesh.creation.icosphere(radius=0.1), POSE)


def true_distances(obstacle, x):
    """By Open3D, of every convex part; negative inside."""
    inside = (x - POSE[:3, 3]) @ POSE[:3, :3]
    distances = []
    for part in obstacle.mesh.split():
        scene = o3d.t.geometry.RaycastingScene()
        corners, faces = part.vertices.astype(np.float32), part.faces.astype(np.uint32)
        scene.add_triangles(o3d.core.Tensor(corners), o3d.core.Tensor(faces))
        points = o3d.core.Tensor(inside.astype(np.float32))
        distances.append(scene.compute_signed_distance(points).numpy())
    return np.min(distances, axis=0)


def test_distances_are_lower_bounds_and_exact_over_faces(obstacle):
    x = POSE[:3, 3] + np.random.default_rng(0).uniform(-0.3, 0.3, (600, 3))
    found, truth = obstacle.distance(x), true_distances(obstacle, x)
    np.testing.assert_array_equal(np.sign(found), np.sign(truth))
    assert np.all(found <= truth + 1e-6)
    assert np.all(found >= np.minimum(truth, truth / np.sqrt(3.0)) - 1e-6)  # beside a corner
    if obstacle.name == "box":
        over = np.sum(np.abs((x - POSE[:3, 3]) @ POSE[:3, :3]) > [0.15, 0.1, 0.05], axis=1) == 1
        assert over.sum() > 50
        np.testing.assert_allclose(found[over], truth[over], atol=1e-6)


def test_a_tray_stays_hollow(tmp_path):
    obstacle = StaticObstacle("tray", read_surface(tray(tmp_path), 0.001), POSE)
    within = POSE[:3, :3] @ [0.0, 0.0, 0.05] + POSE[:3, 3]
    assert len(obstacle.parts) == 3
    assert obstacle.distance(within[None])[0] == pytest.approx(0.045, abs=1e-6)


def test_the_grid_holds_the_distances(obstacle):
    other = StaticObstacle.box("other", [0.1, 0.1, 0.1], se3.make_pose(np.eye(3), [-0.4, 0, 0.5]))
    grid = static_grid([obstacle, other])
    x = np.random.default_rng(1).uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.2], (500, 3))
    expected = np.minimum(np.minimum(obstacle.distance(x), other.distance(x)), grid.frame[4])
    near = expected < 0.2  # a bound of less than max_distance may stand for more than that
    assert near.sum() > 30
    np.testing.assert_allclose(grid.distance_and_gradient(x[near])[0], expected[near], atol=0.01)
    both = nearest_of(static_grid([obstacle]), static_grid([other]))
    np.testing.assert_array_equal(both.values, grid.values)
    assert nearest_of(None, grid) is grid and nearest_of(grid, None) is grid
    assert nearest_of(None, None) is None


def test_what_has_no_thickness_is_refused():
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    with pytest.raises(MeshError, match="sheet has a part that is flat"):
        StaticObstacle("sheet", sheet, POSE)
