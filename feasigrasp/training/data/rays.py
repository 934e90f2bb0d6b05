"""Rays cast on the surfaces of objects, by Open3D on one thread."""

from __future__ import annotations

from typing import Any

import numpy as np
import open3d as o3d
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array


def tensor(array: Any) -> Any:
    """An Open3D tensor; its stubs refuse typed arrays."""
    core: Any = o3d.core
    return core.Tensor(np.ascontiguousarray(array))


def ray_scene(vertices: Array, faces: NDArray[Any]) -> Any:
    """A scene of one triangle mesh [m]."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(
        tensor(np.asarray(vertices, np.float32)), tensor(np.asarray(faces, np.uint32))
    )
    return scene


def cast_rays(scene: Any, starts: Array, ways: Array) -> tuple[Array, NDArray[Any]]:
    """Length (n,) of rays to their first hit, inf without, and the number of the face there.

    Args:
        scene: See `ray_scene`.
        starts: Shape (n, 3) [m].
        ways: Unit vectors, shape (n, 3).
    """
    rays = np.concatenate([starts, ways], axis=1).astype(np.float32)
    hit = scene.cast_rays(tensor(rays), nthreads=1)
    return np.asarray(hit["t_hit"].numpy(), dtype=float), hit["primitive_ids"].numpy()
