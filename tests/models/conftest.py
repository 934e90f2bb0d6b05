"""Clouds and true surfaces for tests of the distance field; grasps and rollouts for control."""

import numpy as np
import open3d as o3d
import pytest
import trimesh

from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.robot.kinematics import forward_kinematics

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


@pytest.fixture(scope="session")
def ring_of_grasps():
    """Grasps of an upright cylinder from all sides, at three heights; frame O is its middle."""
    poses = []
    for angle in np.linspace(0, 2 * np.pi, 16, endpoint=False):
        c, s = np.cos(angle), np.sin(angle)
        for height in (-0.03, 0.0, 0.03):
            closing, approach = np.array([-s, c, 0.0]), np.array([-c, -s, 0.0])
            X_OG = np.eye(4)
            X_OG[:3, :3] = np.column_stack([closing, np.cross(approach, closing), approach])
            X_OG[:3, 3] = [0.0, 0.0, height]
            poses.append(X_OG)
    n = len(poses)
    return GraspSet(np.array(poses), np.full(n, 0.05), np.ones(n))


class Rollout:
    """Positions and errors of a kinematic arm that does exactly as its controller says."""

    def __init__(self, controller, motion, grasps, q, duration, period=0.005):
        """``controller(t, q, X_WO, V_WO)`` gives joint velocities; ``motion(t)`` X_WO and V_WO."""
        self.times = period * np.arange(round(duration / period))
        self.q, self.qd, self.errors = [], [], []
        for t in self.times:
            X_WO, V_WO = motion(t)
            X_OH = np.linalg.inv(X_WO) @ forward_kinematics(q, ParallelGripper().X_FG)
            errors = grasp_errors(grasps.X_OG, X_OH)
            self.errors.append(errors[np.argmin(errors @ [1.0, 0.1])])
            qd = controller(t, q, X_WO, V_WO)
            self.q.append(q)
            self.qd.append(qd)
            q = q + period * qd
        self.q, self.qd, self.errors = map(np.array, (self.q, self.qd, self.errors))

    def worst_after(self, start):
        """Largest position [mm] and angle [deg] error from a time on."""
        position, angle = self.errors[self.times >= start].max(axis=0)
        return 1e3 * position, np.rad2deg(angle)


@pytest.fixture(scope="session")
def roll_out():
    """``roll_out(controller, motion, grasps, q, duration)``: a `Rollout` at 200 Hz."""
    return Rollout
