"""Which poses of the hand keep clear of everything beside the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.scene_field import SceneField


def scene_clear(
    scene: SceneField, X_WG: ArrayLike, gripper: ParallelGripper, margin: float = 0.005
) -> Mask:
    """Which poses of the open hand keep clear of a scene.

    Args:
        scene: The scene, in frame W.
        X_WG: Hand poses in the same frame, shape (n, 4, 4).
        gripper: The hand, fully open.
        margin: Least distance of the hand from every surface [m].

    Returns:
        Shape (n,).
    """
    points = _hand_points(X_WG, gripper)
    hits = scene.closer_than(points.reshape(-1, 3), margin)
    return np.asarray(~hits.reshape(points.shape[:2]).any(axis=1))


def unseen_clear(
    scene: SceneField, X_WG: ArrayLike, gripper: ParallelGripper, margin: float = 0.005
) -> Mask:
    """Which keep clear of what was never seen and may belong to the scene; as `scene_clear`."""
    points = _hand_points(X_WG, gripper)
    distance = scene.unseen_distance(points.reshape(-1, 3), margin)
    return np.asarray((distance >= margin).reshape(points.shape[:2]).all(axis=1))


def _hand_points(X_WG: ArrayLike, gripper: ParallelGripper) -> Array:
    """Points on the open hand at each of n poses, shape (n, k, 3) [m]."""
    poses = np.asarray(X_WG, dtype=float).reshape(-1, 4, 4)
    hand = gripper.surface_points(gripper.max_opening)
    points: Array = np.einsum("nij,kj->nki", poses[:, :3, :3], hand) + poses[:, None, :3, 3]
    return points
