"""Signed-distance grid of static obstacles."""

from collections.abc import Sequence

import numpy as np

from feasigrasp.models.clouds.observed_space import SCENE_VOXEL
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.objects.static_obstacles import StaticObstacle
from feasigrasp.models.shape.grids import ARM_BOX, FAR_ENOUGH


def static_grid(obstacles: Sequence[StaticObstacle]) -> ObstacleGrid:
    """The grid of static obstacles where the arm can reach, on the nodes of `obstacle_grid`."""
    low, size = ARM_BOX
    shape = np.ceil(size / SCENE_VOXEL).astype(int) + 1
    values = np.full(shape, FAR_ENOUGH, dtype=np.float32)
    for obstacle in obstacles:
        near = (obstacle.bounds + [[-FAR_ENOUGH], [FAR_ENOUGH]] - low) / SCENE_VOXEL
        first = np.clip(np.floor(near[0]).astype(int), 0, shape)
        end = np.clip(np.ceil(near[1]).astype(int) + 1, 0, shape)
        block = values[tuple(slice(a, b) for a, b in zip(first, end, strict=True))]
        nodes = np.moveaxis(np.indices(block.shape), 0, -1) + first
        np.minimum(block, obstacle.distance(nodes * SCENE_VOXEL + low), out=block)
    return ObstacleGrid(values, np.array([*low, SCENE_VOXEL, FAR_ENOUGH]))


def nearest_of(first: ObstacleGrid | None, second: ObstacleGrid | None) -> ObstacleGrid | None:
    """The grid of what two grids on the same nodes hold, each of which may be missing."""
    if first is None or second is None:
        return first or second
    return ObstacleGrid(np.minimum(first.values, second.values), first.frame)
