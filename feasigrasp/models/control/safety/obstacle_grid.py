"""A scene's distance on a voxel grid: a look-up costs a fraction of a microsecond, the field 30.

A node has the distance to the observed point that is nearest, by a distance transform. Near a
surface it has that of the scene's field (`feasigrasp.models.shape.scene_field`), if that is less:
the field knows what lies between the points and which side is inside, the points know the edges,
which the field rounds. Space that was never seen and may belong to a surface is as good as seen.
Between the nodes the distance is trilinear, and its gradient is that of this.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, Frozen, kept_with_value
from feasigrasp.models.clouds.seen_space import SCENE_VOXEL
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.points import nearest_distance
from feasigrasp.models.grasps.hand_clearance import INVENTED, MARGIN_GROWTH
from feasigrasp.models.quantities import TWIST, UNKNOWN_POSE, ArrayOf, NotNegative
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.shape.gpdf_fit import Gpdf
from feasigrasp.models.shape.scene_field import SceneField
from feasigrasp.models.shape.surface_error import surface_deviation

#: What the arm with a hand reaches about its shoulder, and how far below the base [m].
_REACH, _BELOW = 1.2, 0.2
#: The box of that, in the frame of the base: its lowest corner and its size [m].
ARM_BOX = (
    np.array([-_REACH, -_REACH, -_BELOW]),
    np.array([2 * _REACH, 2 * _REACH, _BELOW + IIWA_7.joint_heights[1] + _REACH]),
)
#: Nodes so many voxels from an observed point ask the field.
_BAND = 2.0
#: A point with a raw distance below this is on the surface [m].
_ON_SURFACE = 1e-3


@dataclass(frozen=True, eq=False)
class ObstacleGrid(Frozen):
    """Signed distances to a scene on a regular grid, in the frame of the arm's base.

    Attributes:
        values: Distances at the nodes, shape (nx, ny, nz) [m], at most ``max_distance``.
        frame: Position of the first node x, y, z [m], edge length of a voxel [m], and the distance
            that counts as far [m]: the kernel's parameters, shape (5,).
        seen: The same without surface that is far from all that was seen; None if there is none.
    """

    values: Annotated[NDArray[np.float32], ArrayOf(("x", "y", "z"), "m", dtype=np.float32)]
    frame: Annotated[Array, ArrayOf((5,), "m")]
    seen: ObstacleGrid | None = None

    def __post_init__(self) -> None:
        """Checks and freezes the arrays."""
        check_fields(self, ControlError)
        self._freeze(values=self.values, frame=self.frame)

    def distance_and_gradient(self, x: ArrayLike) -> tuple[Array, Array]:
        """Distances (m,) [m] and their gradients (m, 3) at points x (m, 3) [m].

        Outside the grid nothing is known, and nothing near: ``max_distance`` with gradient zero.
        """
        x = np.ascontiguousarray(x, dtype=float).reshape(-1, 3)
        distance, gradient = np.empty(len(x)), np.empty((len(x), 3))
        _lookup(x, self.values, self.frame, distance, gradient)
        return distance, gradient


@dataclass(frozen=True, eq=False)
class MovingObject:
    """An object that the hand keeps off while it moves.

    Attributes:
        grid: Distances to its surface, in the object's frame O.
        X_WO: Its pose, shape (4, 4) [m].
        V_WO: Its twist [angular; linear], of its origin, shape (6,) [rad/s; m/s].
        reserve: Within this distance beyond its clearance the hand comes nearer but slowly [m].
        astray: Whether it is between the fingers, but for no grasp that the hand goes for.
    """

    grid: ObstacleGrid
    X_WO: Annotated[Array, UNKNOWN_POSE]
    V_WO: Annotated[Array, TWIST]
    reserve: NotNegative = 0.0
    astray: bool = False

    def __post_init__(self) -> None:
        """Checks what it is made of."""
        check_fields(self, ControlError)


@compiled
def grid_kernel(x, values, frame):
    """Distance and gradient (a tuple of 3) at one point: trilinear between the nodes."""
    nx, ny, nz = values.shape
    per_metre = 1.0 / frame[3]
    u, v, w = (
        (x[0] - frame[0]) * per_metre,
        (x[1] - frame[1]) * per_metre,
        (x[2] - frame[2]) * per_metre,
    )
    if not (0.0 <= u < nx - 1 and 0.0 <= v < ny - 1 and 0.0 <= w < nz - 1):
        return frame[4], (0.0, 0.0, 0.0)
    i, j, k = int(u), int(v), int(w)
    u, v, w = u - i, v - j, w - k
    c000, c001 = values[i, j, k], values[i, j, k + 1]
    c010, c011 = values[i, j + 1, k], values[i, j + 1, k + 1]
    c100, c101 = values[i + 1, j, k], values[i + 1, j, k + 1]
    c110, c111 = values[i + 1, j + 1, k], values[i + 1, j + 1, k + 1]
    # Along z, then y, then x; each difference is the slope across the voxel.
    c00, c01 = c000 + w * (c001 - c000), c010 + w * (c011 - c010)
    c10, c11 = c100 + w * (c101 - c100), c110 + w * (c111 - c110)
    c0, c1 = c00 + v * (c01 - c00), c10 + v * (c11 - c10)
    gx = c1 - c0
    gy = (c01 - c00) + u * ((c11 - c10) - (c01 - c00))
    low = (c001 - c000) + v * ((c011 - c010) - (c001 - c000))
    high = (c101 - c100) + v * ((c111 - c110) - (c101 - c100))
    gz = low + u * (high - low)
    return c0 + u * gx, (gx * per_metre, gy * per_metre, gz * per_metre)


@compiled
def box_distance_kernel(x, shape, frame):
    """Distance to the box of the surface in an `object_grid`, and its gradient (a tuple of 3).

    The grid ends at a distance at which something quick could no longer brake. Beyond it, the
    distance to the box that encloses the surface is a lower bound; 0 in the box.
    """
    low = frame[0] + frame[4], frame[1] + frame[4], frame[2] + frame[4]
    high = (
        frame[0] + (shape[0] - 1) * frame[3] - frame[4],
        frame[1] + (shape[1] - 1) * frame[3] - frame[4],
        frame[2] + (shape[2] - 1) * frame[3] - frame[4],
    )
    d = (
        x[0] - min(max(x[0], low[0]), high[0]),
        x[1] - min(max(x[1], low[1]), high[1]),
        x[2] - min(max(x[2], low[2]), high[2]),
    )
    distance = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    per = 1.0 / max(distance, 1e-9)
    return distance, (d[0] * per, d[1] * per, d[2] * per)


@compiled
def _lookup(x, values, frame, distance, gradient):
    for m in range(len(x)):
        distance[m], g = grid_kernel((x[m, 0], x[m, 1], x[m, 2]), values, frame)
        gradient[m, 0], gradient[m, 1], gradient[m, 2] = g


@compiled
def _nearest_point_kernel(points, low, size, squares):
    """Lowers ``squares`` (nx, ny, nz) to the squared distance of each node's nearest point.

    Points tell the nodes around them; nodes tell their neighbours which point they took, in sweeps
    through the grid along each of its eight diagonals (vector distance transform, Danielsson 1980).
    """
    n = squares.shape
    taken = np.full(n, -1, dtype=np.int32)
    for m in range(len(points)):
        base = [int(np.rint((points[m, d] - low[d]) / size)) for d in range(3)]
        for i in range(max(base[0] - 1, 0), min(base[0] + 2, n[0])):
            for j in range(max(base[1] - 1, 0), min(base[1] + 2, n[1])):
                for k in range(max(base[2] - 1, 0), min(base[2] + 2, n[2])):
                    _take(points, m, low, size, i, j, k, taken, squares)
    for sweep in range(8):
        di, dj, dk = 1 - 2 * (sweep & 1), 1 - (sweep & 2), 1 - (sweep & 4) // 2
        for a in range(n[0]):
            i = a if di > 0 else n[0] - 1 - a
            for b in range(n[1]):
                j = b if dj > 0 else n[1] - 1 - b
                for c in range(n[2]):
                    k = c if dk > 0 else n[2] - 1 - c
                    if a > 0 and taken[i - di, j, k] >= 0:
                        _take(points, taken[i - di, j, k], low, size, i, j, k, taken, squares)
                    if b > 0 and taken[i, j - dj, k] >= 0:
                        _take(points, taken[i, j - dj, k], low, size, i, j, k, taken, squares)
                    if c > 0 and taken[i, j, k - dk] >= 0:
                        _take(points, taken[i, j, k - dk], low, size, i, j, k, taken, squares)


@compiled(forceinline=True)
def _take(points, m, low, size, i, j, k, taken, squares):
    """Lets node i, j, k take point m if it is nearer than the one it has."""
    x, y, z = low[0] + size * i, low[1] + size * j, low[2] + size * k
    square = (x - points[m, 0]) ** 2 + (y - points[m, 1]) ** 2 + (z - points[m, 2]) ** 2
    if square < squares[i, j, k]:
        squares[i, j, k] = square
        taken[i, j, k] = m


@kept_with_value  # made once per scene, by who sees it; the controllers look it up
def obstacle_grid(
    scene: SceneField, *, voxel_size: float = SCENE_VOXEL, max_distance: float = 0.4
) -> ObstacleGrid:
    """The grid of a scene where the arm can reach; takes about a tenth of a second.

    Args:
        scene: The scene, in the frame of the arm's base, without the arm and what it grasps.
        voxel_size: Edge length of a voxel [m].
        max_distance: Farther away is far enough [m].
    """
    low, size = ARM_BOX
    shape = tuple((np.ceil(size / voxel_size).astype(int) + 1).tolist())
    values = np.full(shape, max_distance**2)
    _nearest_point_kernel(np.ascontiguousarray(scene.points), low, voxel_size, values)
    near = np.nonzero(values < (_BAND * voxel_size) ** 2)
    if len(scene.unseen):
        _nearest_point_kernel(np.ascontiguousarray(scene.unseen), low, voxel_size, values)
    values = np.sqrt(values)
    if len(near[0]) > 0:
        nodes = np.stack(near, axis=1) * voxel_size + low
        values[near] = np.minimum(values[near], scene.distance(nodes))
    return ObstacleGrid(values.astype(np.float32), np.array([*low, voxel_size, max_distance]))


@kept_with_value  # the same field comes along with every tick of the sequencer
def object_grid(
    gpdf: Gpdf, *, voxel_size: float = 0.008, max_distance: float = 0.05
) -> ObstacleGrid:
    """The grid of where an object's surface may be, in the field's frame.

    Completed surface counts as nearer than it is by half of the deviation that is expected of it,
    as for grasps (`feasigrasp.models.grasps.hand_clearance`). What the camera has looked through is
    free, also where the field fills it, as it fills a bowl: a finger may go there. What nobody has
    seen is not, but it may be that nothing is there: `ObstacleGrid.seen` is the grid without it.

    Args:
        gpdf: Distance field of the object.
        voxel_size: Edge length of a voxel [m].
        max_distance: Farther away is far enough; the grid ends there [m].
    """
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
    told = (values < band) & (field >= 0.0) | filled
    seen = ObstacleGrid(np.where(told, field, values).astype(np.float32), frame)
    return ObstacleGrid(whole, frame, seen)


def _between(gpdf: Gpdf, surface: Array, nodes: Array, size: float) -> Array:
    """Surface that is far from the points of it (k, 3), as seen from some of the nodes (n, 3).

    On a long object they are farther apart than a finger is wide.
    """
    nodes = nodes[nearest_distance(nodes, surface) > _BAND * size]
    points = gpdf.refine(nodes[np.abs(gpdf.distance(nodes)) < size], 3)[1]
    there = np.abs(gpdf.distance(points)) < _ON_SURFACE
    there[there] = gpdf.possible(points[there])
    return points[there]


def _to_nearest(points: Array, low: Array, voxel_size: float, farthest: Array) -> Array:
    """Distances of a grid's nodes to the nearest of some points, at most ``farthest`` [m]."""
    squares = farthest**2
    _nearest_point_kernel(points, low, voxel_size, squares)
    return np.asarray(np.sqrt(squares))
