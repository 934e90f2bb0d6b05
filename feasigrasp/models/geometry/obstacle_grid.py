"""Signed distances on a regular grid, with trilinear interpolation and its gradient."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.compiled import compiled
from feasigrasp.models.quantities import TWIST, UNKNOWN_POSE, ArrayOf, NotNegative


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
    seen: "ObstacleGrid | None" = None

    def __post_init__(self) -> None:
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


#: Nothing to keep off. Source: definition.
NO_GRID = ObstacleGrid(np.empty((0, 0, 0), dtype=np.float32), np.zeros(5))


@dataclass(frozen=True, eq=False)
class MovingObject:
    """A moving object as an obstacle, with extra clearance.

    Attributes:
        grid: Distances to its surface, in the object's frame O.
        X_WO: Its pose, shape (4, 4) [m].
        V_WO: Its twist [angular; linear], of its origin, shape (6,) [rad/s; m/s].
        extra_clearance: Within this distance beyond its clearance the hand comes nearer but slowly
            [m].
        misaligned: Whether it is between the fingers, but for no grasp that the hand goes for.
    """

    grid: ObstacleGrid
    X_WO: Annotated[Array, UNKNOWN_POSE]
    V_WO: Annotated[Array, TWIST]
    extra_clearance: NotNegative = 0.0
    misaligned: bool = False

    def __post_init__(self) -> None:
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
