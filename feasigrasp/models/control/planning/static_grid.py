"""Signed-distance grid of static obstacles."""

from collections.abc import Sequence

import numpy as np

from feasigrasp.models.clouds.observed_space import SCENE_VOXEL
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.shape.grids import ARM_BOX


def static_grid(
    obstacles: Sequence[StaticObstacle],
    *,
    voxel_size: float = SCENE_VOXEL,
    max_distance: float = 0.4,
) -> ObstacleGrid:
    """The grid of static obstacles where the arm can reach, on the nodes of `obstacle_grid`.

    Args:
        obstacles: The bodies.
        voxel_size: Edge length of a voxel [m].
        max_distance: Farther away is far enough [m].
    """
    low, size = ARM_BOX
    shape = np.ceil(size / voxel_size).astype(int) + 1
    values = np.full(shape, max_distance, dtype=np.float32)
    for obstacle in obstacles:
        near = (obstacle.bounds + [[-max_distance], [max_distance]] - low) / voxel_size
        first = np.clip(np.floor(near[0]).astype(int), 0, shape)
        end = np.clip(np.ceil(near[1]).astype(int) + 1, 0, shape)
        block = values[tuple(slice(a, b) for a, b in zip(first, end, strict=True))]
        nodes = np.moveaxis(np.indices(block.shape), 0, -1) + first
        np.minimum(block, obstacle.distance(nodes * voxel_size + low), out=block)
    return ObstacleGrid(values, np.array([*low, voxel_size, max_distance]))


def nearest_of(first: ObstacleGrid | None, second: ObstacleGrid | None) -> ObstacleGrid | None:
    """The grid of what two grids on the same nodes hold, each of which may be missing."""
    if first is None or second is None:
        return first or second
    return ObstacleGrid(np.minimum(first.values, second.values), first.frame)
