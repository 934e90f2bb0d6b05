"""Clouds and true surfaces for the tests of the distance field and what is built on it."""

import numpy as np
import open3d as o3d
import pytest
import trimesh

CAMERA_DISTANCE = 0.5
DEPTH_NOISE = 0.001


def _sphere_cloud(count=512, radius=0.05):
    i = np.arange(count) + 0.5
    polar, azimuth = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    return radius * np.column_stack(
        [np.cos(azimuth) * np.sin(polar), np.sin(azimuth) * np.sin(polar), np.cos(polar)]
    )


@pytest.fixture(scope="session")
def sphere_cloud():
    """``sphere_cloud(count, radius)``: points spread evenly over a sphere (Fibonacci lattice)."""
    return _sphere_cloud


@pytest.fixture(scope="session")
def true_shapes():
    """Graspable shapes with a known true surface: box, can, bottle."""
    bottle = [[0, -0.1], [0.034, -0.1], [0.034, 0.02], [0.014, 0.06], [0.014, 0.1], [0, 0.1]]
    return {
        "box": Truth(trimesh.creation.box((0.06, 0.09, 0.15))),
        "can": Truth(trimesh.creation.cylinder(0.033, 0.11, sections=64)),
        "bottle": Truth(trimesh.creation.revolve(np.array(bottle), sections=64)),
    }


class Truth:
    """Ray casts against the true mesh."""

    def __init__(self, mesh):
        self.mesh = mesh
        self.scene = o3d.t.geometry.RaycastingScene()
        self.scene.add_triangles(
            o3d.core.Tensor(np.asarray(mesh.vertices, dtype=np.float32)),
            o3d.core.Tensor(np.asarray(mesh.faces, dtype=np.uint32)),
        )

    def cast(self, starts, directions):
        """Distance to the first hit (inf: none) and the geometric normal there."""
        rays = np.column_stack([starts, directions]).astype(np.float32)
        hit = self.scene.cast_rays(o3d.core.Tensor(rays))
        return hit["t_hit"].numpy().astype(float), hit["primitive_normals"].numpy().astype(float)

    def signed_distance(self, points):
        return self.scene.compute_signed_distance(
            o3d.core.Tensor(np.asarray(points, dtype=np.float32))
        ).numpy()

    def views(self, count, rng):
        """Merged noisy depth images from cameras all round: cloud and directions to the cameras."""
        first = rng.uniform(0, 2 * np.pi)
        clouds, directions = [], []
        for i in range(count):
            azimuth, elevation = first + 2 * np.pi * i / count, rng.uniform(0.2, 1.0)
            back = np.array(
                [
                    np.cos(azimuth) * np.cos(elevation),
                    np.sin(azimuth) * np.cos(elevation),
                    np.sin(elevation),
                ]
            )
            right = np.cross(-back, [0, 0, 1.0])
            right /= np.linalg.norm(right)
            down = np.cross(-back, right)
            u, v = np.meshgrid(np.linspace(-0.4, 0.4, 160), np.linspace(-0.4, 0.4, 160))
            rays = u.reshape(-1, 1) * right + v.reshape(-1, 1) * down - back
            camera = self.mesh.bounds.mean(axis=0) + CAMERA_DISTANCE * back
            depth, _ = self.cast(np.tile(camera, (len(rays), 1)), rays)
            seen = np.isfinite(depth)
            depth = depth[seen] + rng.normal(scale=DEPTH_NOISE, size=seen.sum())
            clouds.append(camera + depth[:, None] * rays[seen])
            directions.append(camera - clouds[-1])
        return np.concatenate(clouds), np.concatenate(directions)
