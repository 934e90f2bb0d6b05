"""One depth image as a test of free space along the camera's rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import minimum_filter

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import project

#: A depth z is reckoned to err by this times z^2 at most [1/m]: nearly three standard deviations of
#: a D435 whose images are 424 pixels wide.
DEPTH_ERROR = 0.02
#: A known point this much nearer than the measured depth is no longer there [m].
_GONE = 0.03
#: Every so many pixels, along each side, fit the camera's intrinsics.
_STRIDE = 4
#: Fewer pixels, or a smaller spread of their directions, do not.
_MIN_PIXELS, _MIN_SPREAD = 20, 0.02


@dataclass(frozen=True, eq=False)
class DepthView(Frozen):
    """Depth image of a camera with its pose.

    Attributes:
        depth: Least depth among each pixel and its neighbours, shape (h, w) [m]: at an edge it is
            that of the nearer surface. 0 where nothing was measured.
        X_WC: Pose of the camera, z forward, shape (4, 4) [m].
        pinhole: fx, fy, cx, cy [px], for whole-numbered pixels.
    """

    depth: Array
    X_WC: Array
    pinhole: tuple[float, float, float, float]

    @classmethod
    def of_cloud(cls, points: NDArray[np.floating], X_WC: ArrayLike) -> DepthView | None:
        """The view that a pixel-ordered cloud shows; None if too few of its pixels have a point.

        The intrinsics are those that map its points to its pixels.

        Args:
            points: Points by pixel, in W, not finite where nothing was measured, shape (3, h, w).
            X_WC: Pose of the camera, shape (4, 4).
        """
        X_WC = np.array(X_WC, dtype=float)
        offset = points.reshape(3, -1) - X_WC[:3, 3:]
        with np.errstate(invalid="ignore"):  # infinity times zero, where nothing was measured
            x, y, z = (X_WC[:3, :3].T @ offset).reshape(points.shape)
        valid = np.isfinite(z) & (z > 0.0)
        rows, columns = np.nonzero(valid[::_STRIDE, ::_STRIDE])
        rows, columns = _STRIDE * rows, _STRIDE * columns
        if len(rows) < _MIN_PIXELS:
            return None
        right, down = (side[rows, columns] / z[rows, columns] for side in (x, y))
        if min(np.ptp(right), np.ptp(down)) < _MIN_SPREAD:
            return None
        fx, cx = np.polyfit(right, columns, 1)
        fy, cy = np.polyfit(down, rows, 1)
        depth = np.where(valid, z, np.inf)
        depth = np.where(valid, minimum_filter(depth, size=3, mode="nearest"), 0.0)
        return cls(depth, X_WC, (float(fx), float(fy), float(cx), float(cy)))

    def looks_through(self, points: Array) -> Mask:
        """Mask of points (n, 3) in W with measured depth behind them, shape (n,)."""
        points_C = (points - self.X_WC[:3, 3]) @ self.X_WC[:3, :3]
        z, (column, row) = points_C[:, 2], map(np.rint, project(points_C, self.pinhole))
        height, width = self.depth.shape
        inside = (z > 0.0) & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        through = np.zeros(len(points), dtype=bool)
        pixels = row[inside].astype(int), column[inside].astype(int)
        through[inside] = self.depth[pixels] > z[inside] + _GONE + DEPTH_ERROR * z[inside] ** 2
        return through
