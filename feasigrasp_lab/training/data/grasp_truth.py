"""Ground-truth validity of grasps, by the object's mesh.

A grasp is valid if it is antipodal, the line on which the pads close lies within a friction cone
at both faces that the pads meet first, and if the whole open hand (fingers, palm and camera, as
solid boxes) is clear of the surface.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp_lab.training.data.grasp_label_kernels import collides
from feasigrasp_lab.training.data.raycasting import Raycaster

#: Half angle of the friction cone at either contact [deg]. Source: guessed.
CONE_DEG = 20.0
#: Distance of the surface samples that the hand is tested against [m]; most samples of one mesh.
#: Source: guessed.
SAMPLE_SPACING, MAX_SAMPLES = 0.0025, 20_000


@dataclass(frozen=True, eq=False)
class Closing:
    """What two pads meet that close along the x-axis of grasp frames.

    Attributes:
        first: Where the pad that moves along +x meets the object, shape (n, 3) [m].
        width: Distance between the two, shape (n,) [m]; NaN where nothing is between the pads.
        cosine: The lesser of the cosines between closing line and surface normal at the two
            faces, 1 for a perfect pair, shape (n,).
    """

    first: Array
    width: Array
    cosine: Array


class TrueGrasps:
    """Judges grasps on the true surface of an object.

    Args:
        mesh: The closed surface, in the frame that the grasps are given in [m].
    """

    def __init__(self, mesh: trimesh.Trimesh) -> None:
        self.mesh = mesh
        self.surface = Raycaster(mesh.vertices, mesh.faces)
        self.samples = surface_samples(mesh)

    def cast(self, starts: Array, directions: Array) -> tuple[Array, Array]:
        """Length of rays to their first hit (inf without) and outward normals there.

        Args:
            starts: Shape (n, 3) [m].
            directions: Unit vectors, shape (n, 3).

        Returns:
            Shapes (n,) [m] and (n, 3).
        """
        length, face = self.surface.cast(starts, directions)
        return length, self._normals(face)

    def closest(self, points: Array) -> tuple[Array, Array]:
        """Nearest points of the surface to points (n, 3), and the outward normals there."""
        at, face = self.surface.closest(points)
        return at, self._normals(face)

    def close(self, X_OG: ArrayLike, opening: float) -> Closing:
        """Closes two pads along the x-axis of grasp frames (n, 4, 4) from an opening [m]."""
        poses = np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)
        return self.close_lines(poses[:, :3, 3], poses[:, :3, 0], opening)

    def close_lines(self, centers: Array, closing: Array, opening: float) -> Closing:
        """As `close`, for middles (n, 3) [m] and unit directions (n, 3) of closing lines."""
        left, n_left = self.cast(centers - 0.5 * opening * closing, closing)
        right, n_right = self.cast(centers + 0.5 * opening * closing, -closing)
        width = opening - left - right
        # Two surfaces closer than this along the closing line hold nothing between them [m].
        held = np.isfinite(width) & (width > 1e-4)
        cosine = np.minimum(
            -np.einsum("ij,ij->i", n_left, closing), np.einsum("ij,ij->i", n_right, closing)
        )
        along = np.where(held, left, 0.0)[:, None]
        return Closing(
            first=centers + (along - 0.5 * opening) * closing,
            width=np.where(held, width, np.nan),
            cosine=np.where(held, cosine, -1.0),
        )

    def truly_antipodal(self, X_OG: ArrayLike, opening: float) -> Mask:
        """Whether pads that close from an opening [m] meet faces that hold each other, (n,)."""
        return self.close(X_OG, opening).cosine >= np.cos(np.deg2rad(CONE_DEG))

    def hand_free(self, X_OG: ArrayLike, gripper: ParallelGripper) -> Mask:
        """Whether the whole open hand, as solid boxes, is clear of the object, (n,)."""
        poses = np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)
        boxes = hand_boxes(gripper)
        free: Mask = ~collides(self.samples, np.ascontiguousarray(poses), boxes)
        # A box that is wholly inside the object has none of its surface in it.
        maybe = np.flatnonzero(free)
        X = poses[maybe]
        middles = boxes.mean(axis=1) @ X[:, :3, :3].swapaxes(1, 2) + X[:, None, :3, 3]
        inside = self.surface.inside(middles.reshape(-1, 3)).reshape(-1, len(boxes))
        free[maybe] &= ~inside.any(axis=1)
        return free

    def valid(self, X_OG: ArrayLike, gripper: ParallelGripper) -> Mask:
        """Whether grasps (n, 4, 4) by the open hand are antipodal and free of collision, (n,)."""
        poses = np.asarray(X_OG, dtype=float).reshape(-1, 4, 4)
        good = self.truly_antipodal(poses, gripper.max_opening)
        good[good] = self.hand_free(poses[good], gripper)
        return good

    def _normals(self, triangles: NDArray[Any]) -> Array:
        """Outward normals of faces by their number, zero for no face."""
        none = triangles >= len(self.mesh.faces)
        normals = self.mesh.face_normals[np.where(none, 0, triangles)]
        return np.where(none[:, None], 0.0, normals)


def hand_boxes(gripper: ParallelGripper, margin: float = 0.0) -> Array:
    """The open hand in the grasp frame as boxes, grown by a margin [m] on all sides.

    Returns:
        Lower and upper corners of two fingers, palm and camera, shape (4, 2, 3) [m].
    """
    inner = 0.5 * gripper.max_opening
    outer, side = inner + gripper.finger_thickness, 0.5 * gripper.finger_width
    palm, box = 0.5 * np.array(gripper.palm_size), 0.5 * np.array(gripper.camera_box)
    palm_center = np.array([0.0, 0.0, gripper.heel - palm[2]])
    camera_center = np.array(gripper.camera_center)
    boxes = np.array(
        [
            [[inner, -side, gripper.heel], [outer, side, gripper.tip]],
            [[-outer, -side, gripper.heel], [-inner, side, gripper.tip]],
            [palm_center - palm, palm_center + palm],
            [camera_center - box, camera_center + box],
        ]
    )
    boxes[:, 0] -= margin
    boxes[:, 1] += margin
    return boxes


def surface_samples(mesh: trimesh.Trimesh, spacing: float = SAMPLE_SPACING) -> Array:
    """Points that cover a surface: every point of it has one within about the spacing, (n, 3) [m].

    Triangles are divided evenly, so nothing is left to chance; on large meshes the spacing grows.
    """
    spacing = max(spacing, float(np.sqrt(mesh.area / MAX_SAMPLES)))
    corners = np.asarray(mesh.triangles, dtype=float)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    pieces = np.maximum(np.ceil(longest / spacing), 1).astype(int)
    points = [np.asarray(mesh.vertices, dtype=float)]
    for count in np.unique(pieces):
        i, j = (part.ravel() for part in np.mgrid[: count + 1, : count + 1])
        i, j = i[i + j <= count], j[i + j <= count]
        weights = np.stack([i, j, count - i - j], axis=1) / count
        points.append((weights @ corners[pieces == count]).reshape(-1, 3))
    everything = np.concatenate(points)
    cells = np.floor((everything - everything.min(axis=0)) / (0.7 * spacing)).astype(np.int64)
    sides = cells.max(axis=0) + 1
    _, kept = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(sides)), return_index=True)
    return np.ascontiguousarray(everything[kept])
