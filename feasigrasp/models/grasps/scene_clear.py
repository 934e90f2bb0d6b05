"""Which poses of the hand keep clear of everything beside the object."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Mask
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
    poses = np.asarray(X_WG, dtype=float).reshape(-1, 4, 4)
    hand = gripper.surface_points(gripper.max_opening)
    points = np.einsum("nij,kj->nki", poses[:, :3, :3], hand) + poses[:, None, :3, 3]
    hits = scene.closer_than(points.reshape(-1, 3), margin)
    return np.asarray(~hits.reshape(len(poses), len(hand)).any(axis=1))
