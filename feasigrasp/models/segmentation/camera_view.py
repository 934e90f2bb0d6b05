"""What one depth image says, pixel by pixel, and how much it may be off."""

from __future__ import annotations

from typing import NamedTuple

from feasigrasp.models.arrays import Array, Floats


class CameraModel(NamedTuple):
    """A depth camera, as far as segmentation reckons with it.

    Attributes:
        width: Pixels in a row.
        height: Pixels in a column.
        fx: Focal length along x [px].
        fy: Along y [px].
        cx: Principal point, for whole-numbered pixels [px].
        cy: Likewise [px].
        noise: The standard deviation of a depth z is ``noise z^2`` [1/m].
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    noise: float


class CameraView(NamedTuple):
    """One image.

    Attributes:
        points: Points in the world frame W, row by row, not finite where nothing was measured,
            shape (height * width, 3) [m].
        X_WC: Pose of the camera, z forward, x to the right, y down, shape (4, 4).
    """

    points: Floats
    X_WC: Array
