"""Picture of an object, by a software renderer."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.views import ViewedObject, look_at

#: Where shapes are looked at from, and where the light comes from.
_EYE = np.array([0.5, -0.75, 0.5])
_LIGHT = np.array([0.35, -0.55, 0.76])


def shape_picture(obj: RigidObject) -> np.ndarray:
    """A parallel projection from obliquely above, RGB in [0, 1], (pixels, pixels, 3)."""
    # Side of a tile [m]; every shape is drawn to this scale.
    side = 0.22
    pixels = 150
    camera = look_at(_EYE)
    down = np.array([0.0, 0.0, -1.0]) + camera[2, 2] * camera[:3, 2]
    camera[:3, 1] = down / np.linalg.norm(down)
    camera[:3, 0] = np.cross(camera[:3, 1], camera[:3, 2])
    middle = ViewedObject(obj).center
    grid = (np.arange(pixels) + 0.5) / pixels * side - 0.5 * side
    u, v = np.meshgrid(grid, grid)
    starts = np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3) @ camera[:3, :3].T
    starts += camera[:3, 3] + middle
    directions = np.broadcast_to(camera[:3, 2], starts.shape)
    length, normals = TrueGrasps(obj.mesh).cast(starts, directions)
    light = 0.35 + 0.65 * np.clip(normals @ _LIGHT, 0.0, 1.0)
    picture = np.where(np.isfinite(length)[:, None], light[:, None] * np.array(obj.color[:3]), 1.0)
    return picture.reshape(pixels, pixels, 3)
