"""Signed-distance grids of scenes and objects, for the safety QP.

A node has the distance to the nearest observed point, by a vector distance transform (Danielsson
1980). Near a surface it has the distance of the Gaussian process field, if that is less: the field
has the inside and what lies between the points; the points have the edges, which the field rounds.
Unobserved space that may belong to a surface counts as surface.
"""

import numpy as np

from feasigrasp.models.arrays import Array, cached_on_value
from feasigrasp.models.clouds.observed_space import SCENE_VOXEL
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.shape.gpdf import INVENTED, MARGIN_GROWTH, Gpdf, surface_deviation
from feasigrasp.models.shape.scene_field import SceneField

#: The box of what the arm with a hand reaches, in the frame of its base: lowest corner and size
#: [m]. 1.2 m about the shoulder, which is 0.34 m high, and 0.2 m below the base. Source: data
#: sheet: KUKA LBR iiwa 7 R800, with a hand.
ARM_BOX = (np.array([-1.2, -1.2, -0.2]), np.array([2.4, 2.4, 1.74]))
#: Distances in that box are counted up to this [m]. Source: guessed.
FAR_ENOUGH = 0.4
#: Nodes within this number of voxels of an observed point ask the field. Source: guessed.
_BAND = 2.0


@compiled
def _nearest_point_kernel(points, low, size, squares):
    """Lowers ``squares`` (nx, ny, nz) to the squared distance of each node's nearest point.

    Points update the nodes around them; nodes pass their nearest point to neighbours, in sweeps
    through the grid along each of its eight diagonals (vector distance transform, Danielsson 1980).
    """
    n = squares.shape
    taken = np.full(n, -1, dtype=np.int32)
    for m in range(len(points)):
        base = [int(np.rint((points[m, d] - low[d]) / size)) for d in range(3)]
        for i in range(max(base[0] - 1, 0), min(base[0] + 2, n[0])):
            for j in range(max(base[1] - 1, 0), min(base[1] + 2, n[1])):
                for k in range(max(base[2] - 1, 0), min(base[2] + 2, n[2])):
                    _take(points, m, (low, size), (i, j, k), taken, squares)
    for sweep in range(8):
        di, dj, dk = 1 - 2 * (sweep & 1), 1 - (sweep & 2), 1 - (sweep & 4) // 2
        for a in range(n[0]):
            i = a if di > 0 else n[0] - 1 - a
            for b in range(n[1]):
                j = b if dj > 0 else n[1] - 1 - b
                for c in range(n[2]):
                    k = c if dk > 0 else n[2] - 1 - c
                    if a > 0 and taken[i - di, j, k] >= 0:
                        _take(points, taken[i - di, j, k], (low, size), (i, j, k), taken, squares)
                    if b > 0 and taken[i, j - dj, k] >= 0:
                        _take(points, taken[i, j - dj, k], (low, size), (i, j, k), taken, squares)
                    if c > 0 and taken[i, j, k - dk] >= 0:
                        _take(points, taken[i, j, k - dk], (low, size), (i, j, k), taken, squares)


@compiled(forceinline=True)
def _take(points, m, grid, node, taken, squares):
    """Lets a node take point m if it is nearer than the one it has."""
    (low, size), (i, j, k) = grid, node
    x, y, z = low[0] + size * i, low[1] + size * j, low[2] + size * k
    square = (x - points[m, 0]) ** 2 + (y - points[m, 1]) ** 2 + (z - points[m, 2]) ** 2
    if square < squares[i, j, k]:
        squares[i, j, k] = square
        taken[i, j, k] = m


@cached_on_value  # made once per scene, by who sees it; the controllers look it up
def obstacle_grid(scene: SceneField) -> ObstacleGrid:
    """The grid of a scene where the arm can reach; takes about a tenth of a second.

    The scene is in the frame of the arm's base, without the arm and what it grasps.
    """
    low, size = ARM_BOX
    shape = tuple((np.ceil(size / SCENE_VOXEL).astype(int) + 1).tolist())
    values = np.full(shape, FAR_ENOUGH**2)
    _nearest_point_kernel(np.ascontiguousarray(scene.points), low, SCENE_VOXEL, values)
    near = np.nonzero(values < (_BAND * SCENE_VOXEL) ** 2)
    if len(scene.unobserved):
        _nearest_point_kernel(np.ascontiguousarray(scene.unobserved), low, SCENE_VOXEL, values)
    values = np.sqrt(values)
    if len(near[0]) > 0:
        nodes = np.stack(near, axis=1) * SCENE_VOXEL + low
        values[near] = np.minimum(values[near], scene.distance(nodes))
    return ObstacleGrid(values.astype(np.float32), np.array([*low, SCENE_VOXEL, FAR_ENOUGH]))


@cached_on_value  # the same field comes along with every tick of the sequencer
def object_grid(gpdf: Gpdf) -> ObstacleGrid:
    """The grid of where the surface of an object with a distance field may be, in its frame.

    Completed surface counts as nearer than it is by half of the deviation that is expected of it,
    as for grasps (`feasigrasp.models.grasps.hand_clearance`). What the camera has looked through is
    free, also where the field fills it, as it fills a bowl: a finger may go there. What no view has
    seen is not, but it may be that nothing is there: `ObstacleGrid.seen` is the grid without it.
    """
    # Edge length of a voxel; farther away than this is far enough, and the grid ends there [m].
    voxel_size, max_distance = 0.008, 0.05
    surface = np.ascontiguousarray(gpdf.completion.points)
    low = surface.min(axis=0) - max_distance
    cells = np.ceil((np.ptp(surface, axis=0) + 2 * max_distance) / voxel_size).astype(int)
    shape = tuple((cells + 1).tolist())
    nodes = np.moveaxis(np.indices(shape), 0, -1) * voxel_size + low
    band = _BAND * voxel_size
    inside = ((nodes > gpdf.bounds[0] - band) & (nodes < gpdf.bounds[1] + band)).all(axis=-1)
    surface = np.concatenate([surface, _between(gpdf, surface, nodes[inside], voxel_size)])
    values = _to_nearest(surface, low, voxel_size, np.full(shape, max_distance))
    near = values < band
    # Farther inside only the sign matters: the way out is towards the surface.
    bulk = ~near & inside
    field = values.copy()
    field[bulk] *= np.where(gpdf.distance(nodes[bulk]) < 0.0, -1.0, 1.0)
    distance, at, _ = gpdf.refine(nodes[near], 3)
    field[near] = distance - MARGIN_GROWTH * surface_deviation(gpdf, at)
    frame = np.array([*low, voxel_size, max_distance])
    filled = field < 0.0
    filled[filled] = gpdf.possible(nodes[filled])
    whole = np.where((field >= 0.0) | filled, field, values).astype(np.float32)
    observed = gpdf.seen()[0]
    known = nearest_distance(surface, observed) < INVENTED
    if known.all() or not known.any():
        return ObstacleGrid(whole, frame)
    values = _to_nearest(surface[known], low, voxel_size, np.full(shape, max_distance))
    filled[filled] = nearest_distance(nodes[filled], observed) < INVENTED
    decided = (values < band) & (field >= 0.0) | filled
    seen = ObstacleGrid(np.where(decided, field, values).astype(np.float32), frame)
    return ObstacleGrid(whole, frame, seen)


def _between(gpdf: Gpdf, surface: Array, nodes: Array, size: float) -> Array:
    """Surface that is far from the points of it (k, 3), as seen from some of the nodes (n, 3).

    On a long object they are farther apart than a finger is wide.
    """
    nodes = nodes[nearest_distance(nodes, surface) > _BAND * size]
    points = gpdf.refine(nodes[np.abs(gpdf.distance(nodes)) < size], 3)[1]
    # A point with a raw distance below this is on the surface [m].
    there = np.abs(gpdf.distance(points)) < 1e-3
    there[there] = gpdf.possible(points[there])
    return points[there]


def _to_nearest(points: Array, low: Array, voxel_size: float, farthest: Array) -> Array:
    """Distances of a grid's nodes to the nearest of some points, at most ``farthest`` [m]."""
    squares = farthest**2
    _nearest_point_kernel(points, low, voxel_size, squares)
    return np.asarray(np.sqrt(squares))
