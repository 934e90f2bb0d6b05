"""Partial views of a mesh: ray casting, sensor noise, masking."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.sensors.depth_noise import DepthNoise
from feasigrasp_lab.training.data.raycasting import Raycaster

#: The depth stream of the scenarios' camera: a RealSense D435 in its 424 x 240 mode, 87 x 58 deg.
#: Source: data sheet: D435.
WIDTH, HEIGHT = 424, 240
#: Its intrinsics fx, fy, cx, cy [px]. Source: formula.
CAMERA = (
    WIDTH / 2 / np.tan(np.deg2rad(87.0) / 2),
    HEIGHT / 2 / np.tan(np.deg2rad(58.0) / 2),
    WIDTH / 2 - 0.5,
    HEIGHT / 2 - 0.5,
)
#: Distance from the camera to the object's centre, lowest and highest [m]. Source: guessed.
DISTANCE = (0.45, 0.55)


@dataclass(frozen=True, eq=False)
class PartialView:
    """What one camera sees of an object.

    Attributes:
        points: Observed points in the estimated frame O, shape (n, 3) [m].
        p_OC: Position of the camera in the same frame, shape (3,) [m].
        X_OC: True pose of the camera (z forward, x right) in O, shape (4, 4).
        measured: Which pixels of the camera's picture gave these points, shape (HEIGHT, WIDTH).
    """

    points: Array
    p_OC: Array
    X_OC: Array
    measured: Mask


class ViewedObject:
    """A mesh that can be looked at.

    Args:
        obj: The object; its mesh is given in its frame O.
    """

    def __init__(self, obj: RigidObject) -> None:
        self.obj = obj
        self.surface = Raycaster(obj.vertices, obj.faces)
        #: Middle of the object's box, shape (3,) [m].
        self.center: Array = 0.5 * (obj.vertices.min(axis=0) + obj.vertices.max(axis=0))

    def view(
        self,
        X_OC: Array,
        rng: np.random.Generator | None,
        tracking: tuple[float, float] = (0.0, 0.0),
    ) -> PartialView:
        """Looks once.

        Args:
            X_OC: Pose of the camera in O, z forward, shape (4, 4).
            rng: Draws sensor and tracking noise; None for a perfect sensor.
            tracking: Standard deviation of the tracked object pose: position [m] per axis, rotation
                [rad] per axis.

        Returns:
            The points of the pixels that show the object, except those at the edge of its mask.
        """
        depth, (left, top) = self._render(X_OC)
        intrinsics = CAMERA[0], CAMERA[1], CAMERA[2] - left, CAMERA[3] - top
        of_body = np.isfinite(depth)
        if rng is not None:
            depth = DepthNoise().apply(depth, intrinsics, rng)
        seen = np.isfinite(depth) & (depth > 0.0)
        in_camera = unproject(depth, intrinsics)
        used = of_body & seen & ~edge_pixels(in_camera, seen, of_body, EDGE_JUMP)
        rows, columns = np.nonzero(used)
        points_C = in_camera[:, used].T
        calibrated = X_OC
        if rng is not None and any(tracking):
            noise = rng.normal(size=6) * np.repeat([tracking[1], tracking[0]], 3)
            calibrated = se3.exp(noise) @ X_OC
        points = points_C @ calibrated[:3, :3].T + calibrated[:3, 3]
        measured = np.zeros((HEIGHT, WIDTH), dtype=bool)
        measured[rows + top, columns + left] = True
        return PartialView(points, calibrated[:3, 3].copy(), X_OC, measured)

    def sees(self, points: Array, normals: Array, view: PartialView) -> tuple[Mask, Mask]:
        """What a camera has seen of surface points (n, 3) with outward normals (n, 3).

        Returns:
            Which points are in its line of sight, and which of these are in a pixel that gave a
            depth, shape (n,) each.
        """
        start = view.X_OC[:3, 3]
        way = points - start
        length = np.linalg.norm(way, axis=1)
        hit, _ = self.surface.cast(np.broadcast_to(start, points.shape), way / length[:, None])
        # A ray now and then slips through an edge of the mesh, so the normal has a say as well.
        # A point closer to the first hit of its line of sight than this is seen [m].
        in_sight = (hit > length - 1e-3) & (np.einsum("ij,ij->i", way, normals) < 0.0)
        fx, fy, cx, cy = CAMERA
        x, y, z = (way @ view.X_OC[:3, :3]).T
        column = np.clip(np.rint(fx * x / z + cx), 0, WIDTH - 1).astype(int)
        row = np.clip(np.rint(fy * y / z + cy), 0, HEIGHT - 1).astype(int)
        return in_sight, in_sight & view.measured[row, column]

    def _render(self, X_OC: Array) -> tuple[Array, tuple[int, int]]:
        """Depth image, infinite where nothing is hit, of the part of the picture with the object.

        Returns:
            The image, and the column and row of its first pixel.
        """
        fx, fy, cx, cy = CAMERA
        X_CO = se3.inverse(X_OC)
        corners = self.obj.vertices @ X_CO[:3, :3].T + X_CO[:3, 3]
        u = fx * corners[:, 0] / corners[:, 2] + cx
        v = fy * corners[:, 1] / corners[:, 2] + cy
        left, right = np.clip([u.min() - 3, u.max() + 4], 0, WIDTH).astype(int)
        top, bottom = np.clip([v.min() - 3, v.max() + 4], 0, HEIGHT).astype(int)
        cx, cy = cx - left, cy - top
        # Open3D's pixel centres are at halves.
        K = np.array([[fx, 0.0, cx + 0.5], [0.0, fy, cy + 0.5], [0.0, 0.0, 1.0]])
        depth = self.surface.depth_image(K, X_CO, int(right - left), int(bottom - top))
        return depth, (int(left), int(top))


def fused(views: Sequence[PartialView], *, smooth: bool = True) -> FusedCloud:
    """The cloud of some views, merged as perception does it."""
    # Voxels in which views are merged, as in the scenarios [m].
    cloud = FusedCloud.empty(0.003, smooth=smooth)
    for view in views:
        cloud = cloud.merged(view.points, view.p_OC)
    return cloud


def look_at(p_OC: Array, roll: float = 0.0) -> Array:
    """Pose of a camera at ``p_OC`` whose z axis passes through the origin, shape (4, 4)."""
    z = -p_OC / np.linalg.norm(p_OC)
    x, y = perpendiculars(z)
    c, s = np.cos(roll), np.sin(roll)
    return se3.make_pose(np.column_stack([c * x + s * y, c * y - s * x, z]), p_OC)


def turning_views(
    rng: np.random.Generator, center: Array, count: int, turn: tuple[float, float] = (60.0, 120.0)
) -> list[Array]:
    """Camera poses X_OC for an object that turns in front of a camera.

    The first direction and the roll are uniform, the distance to the centre is `DISTANCE`. Between
    two views the object turns by ``turn`` degrees, least and most, about an axis that makes an
    angle of 60 to 120 degrees with the line of sight, as a table in front of a camera at up to 30
    degrees would.
    """
    way = rng.normal(size=3)
    way /= float(np.linalg.norm(way))
    first = look_at(way * rng.uniform(*DISTANCE), rng.uniform(0, 2 * np.pi))
    tilt = np.deg2rad(rng.uniform(-30.0, 30.0))
    axis = first[:3, :3] @ np.array([0.0, np.cos(tilt), np.sin(tilt)])
    poses, angle = [], 0.0
    for _ in range(count):
        X_OC = se3.make_pose(se3.so3_exp(angle * axis), np.zeros(3)) @ first
        X_OC[:3, 3] += center
        poses.append(X_OC)
        angle += np.deg2rad(rng.uniform(*turn))
    return poses
