"""One image of an object for tracking: points, and pixels without the object.

The second is not in the points: pixels that show something behind the object, so that
no part of it can be there.
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, minimum_filter
from scipy.spatial import ConvexHull

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.clouds.edges import Outline, outline
from feasigrasp.models.quantities import CLOUD, POINTS, UNKNOWN_POSE

#: Pixels along the side of a cell, in which silhouettes are kept. Source: guessed.
CELL = 2
#: What is so much farther away than a point of the model is behind it [m]. Source: guessed.
_BEHIND = 0.02


@dataclass(frozen=True, eq=False)
class ObjectView(Frozen):
    """One image of an object.

    Attributes:
        camera: The camera.
        X_WC: Its pose when the image was taken, z forward, shape (4, 4).
        points_W: Points of the object, shape (n, 3) [m].
        depth: The whole image, 0 or NaN where nothing was measured and infinite where it is known
            that there is nothing, shape (h, w) [m]; None if there is none, and nothing is known of
            what is beside the object.
    """

    camera: Camera
    X_WC: Annotated[Array, UNKNOWN_POSE]
    points_W: Annotated[Array, CLOUD]
    depth: NDArray[Any] | None = None

    def __post_init__(self) -> None:
        """Raises CameraError where types or shapes are wrong, or the image is not the camera's."""
        check_fields(self, CameraError)
        size = self.camera.height, self.camera.width
        if self.depth is not None and (self.depth.shape != size or self.depth.dtype.kind != "f"):
            raise CameraError(
                f"ObjectView.depth is {self.depth.dtype} of shape {self.depth.shape}; give depths "
                f"in metres of shape {size}, as the camera has them"
            )

    @cached_property
    def points_C(self) -> Array:
        """The points in the camera's frame, shape (n, 3) [m]."""
        return self.in_camera(self.points_W)

    @cached_property
    def at_border(self) -> Mask:
        """Mask of points so near to the border of the image that it cuts the object off there."""
        return np.asarray(self.camera.to_border(self.points_C) < 4.0)

    @checked(CameraError)
    def in_camera(self, points_W: Annotated[Array, POINTS]) -> Array:
        """Points (n, 3) of the world in the camera's frame."""
        return np.asarray((points_W - self.X_WC[:3, 3]) @ self.X_WC[:3, :3])

    @checked(CameraError)
    def beside(self, points_C: Annotated[Array, POINTS]) -> tuple[Mask, Array]:
        """Mask (n,) of model points (n, 3) at pixels without the object, and their way to it.

        The way from these k points to the line of sight of the nearest pixel that shows the object,
        as far as it exceeds what lost edge pixels explain, (k, 2) [m] along the camera's x and y.
        """
        none = np.zeros(len(points_C), dtype=bool), np.zeros((0, 2))
        if self.depth is None or len(self.points_C) == 0:
            return none
        _, nearest, distance, behind = self._silhouette
        row, column, inside = self._cells(points_C)
        found = inside & (distance[row, column] > 2.0)
        found &= behind[row, column] > points_C[:, 2] + _BEHIND
        if not found.any():
            return none
        row, column = row[found], column[found]
        way = np.stack([nearest[1][row, column] - column, nearest[0][row, column] - row], axis=1)
        length = distance[row, column][:, None]
        excess = way * (1.0 - 2.0 / length) * CELL
        scale = points_C[found, 2:] / np.array(self.camera.intrinsics[:2])
        return found, excess * scale

    @checked(CameraError)
    def on_object(self, points_C: Annotated[Array, POINTS]) -> Mask:
        """Mask of model points (n, 3) at pixels of the object, shape (n,).

        All of them, if nothing is known of what is beside the object.
        """
        if self.depth is None or len(self.points_C) == 0:
            return np.full(len(points_C), len(self.points_C) > 0)
        row, column, inside = self._cells(points_C)
        return np.asarray(inside & (self._silhouette[2][row, column] <= 2.0))

    @checked(CameraError)
    def hidden(self, points_C: Annotated[Array, POINTS]) -> Mask:
        """Mask of model points (n, 3) that are occluded or at pixels without depth.

        None, if nothing is known of what is beside the object.
        """
        if self.depth is None:
            return np.zeros(len(points_C), dtype=bool)
        u, v = (np.rint(c).astype(int) for c in self.camera.pixels(points_C))
        h, w = self.depth.shape
        measured = self.depth[np.clip(v, 0, h - 1), np.clip(u, 0, w - 1)]
        return np.asarray(~(measured >= points_C[:, 2] - _BEHIND))

    def outline(self) -> Outline | None:
        """Pixels without depth inside the convex hull of the object's, in the camera's axes.

        None without an image, or where the object shows less than an area.
        """
        columns, rows = (np.rint(c).astype(int) for c in self.camera.pixels(self.points_C))
        shown = (columns >= 0) & (columns < self.camera.width)
        shown &= (rows >= 0) & (rows < self.camera.height)
        columns, rows = columns[shown], rows[shown]
        if self.depth is None or len(rows) == 0 or min(np.ptp(rows), np.ptp(columns)) < 2:
            return None
        top, left = max(rows.min() - 1, 0), max(columns.min() - 1, 0)
        depth: Array = self.depth[top : rows.max() + 2, left : columns.max() + 2]
        kept: Mask = np.zeros(depth.shape, dtype=bool)
        kept[rows - top, columns - left] = True
        shown = np.flatnonzero(kept.any(axis=1))
        lines = kept[shown]
        ends = lines.argmax(axis=1), kept.shape[1] - 1 - lines[:, ::-1].argmax(axis=1)
        rim = np.stack([np.tile(shown, 2), np.concatenate(ends)], axis=1)
        sides = ConvexHull(rim, qhull_options="QJ").equations
        missing = np.stack(np.nonzero(~(depth > 0.0)), axis=1)
        inside = (missing @ sides[:, :2].T + sides[:, 2] <= 0.0).all(axis=1)
        of_body = kept.copy()
        of_body[tuple(missing[inside].T)] = True
        return outline(kept, of_body, np.zeros_like(kept), (int(top), int(left)), self.camera)

    def _cells(self, points_C: Array) -> tuple[Indices, Indices, Mask]:
        """Row and column of points in the cells of the silhouette, else 0; which are inside."""
        (left, top), _, distance, _ = self._silhouette
        u, v = self.camera.pixels(points_C)
        column, row = (np.floor(a / CELL).astype(int) - b for a, b in ((u, left), (v, top)))
        h, w = distance.shape
        inside = (row >= 0) & (row < h) & (column >= 0) & (column < w)
        return np.where(inside, row, 0), np.where(inside, column, 0), inside

    @cached_property
    def _silhouette(self) -> tuple[tuple[int, int], Indices, Array, Array]:
        """First cell, nearest cell of the object, distance to it [cells], depth known free."""
        # Cells round the object that belong to its picture.
        around = 24
        assert self.depth is not None
        u, v = self.camera.pixels(self.points_C)
        h, w = self.camera.height // CELL, self.camera.width // CELL
        column = np.clip(np.floor(u / CELL).astype(int), 0, w - 1)
        row = np.clip(np.floor(v / CELL).astype(int), 0, h - 1)
        left, top = max(column.min() - around, 0), max(row.min() - around, 0)
        right, bottom = min(column.max() + around, w - 1), min(row.max() + around, h - 1)
        shape = bottom - top + 1, right - left + 1
        mask = np.zeros(shape, dtype=bool)
        mask[row - top, column - left] = True
        depth = self.depth[: h * CELL, : w * CELL]
        part = depth[top * CELL : (bottom + 1) * CELL, left * CELL : (right + 1) * CELL]
        # A pixel that was not measured says nothing, nor do its neighbours.
        cells = (part[i::CELL, j::CELL] for i in range(CELL) for j in range(CELL))
        least = np.nan_to_num(reduce(np.minimum, cells), nan=0.0, posinf=np.inf)
        distance, nearest = distance_transform_edt(~mask, return_indices=True)
        return (int(left), int(top)), nearest, distance, minimum_filter(least, 3)
