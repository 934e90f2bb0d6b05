"""Pinhole model of a depth camera with depth noise that grows with the square of the depth."""

from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.quantities import CLOUD, ArrayOf, Count, NotNegative, Positive

_PIXELS = ArrayOf(("n",), "px")
#: What estimators take a stereo camera for: error of its disparities [px] (Intel, "Best-known
#: methods for tuning the D400 series"), and the distance of its imagers by default that of a
#: RealSense D435 [m]. Source: data sheet: Intel, D400 series and D435.
SUBPIXEL, BASELINE = 0.08, 0.05


@dataclass(frozen=True, eq=False)
class Camera(Frozen):
    """A pinhole camera without distortion.

    Attributes:
        intrinsics: fx, fy, cx, cy for whole-numbered pixels [px].
        width: Pixels in a row.
        height: Pixels in a column.
        near: Least depth that it measures [m].
        depth_noise: Standard deviation of a depth z is this times z^2 [1/m]: subpixel error over
            focal length and baseline.
    """

    intrinsics: tuple[float, float, float, float]
    width: Count
    height: Count
    near: NotNegative
    depth_noise: NotNegative

    def __post_init__(self) -> None:
        """Raises CameraError where a number is not finite, or out of range."""
        check_fields(self, CameraError)
        if min(self.intrinsics[:2]) <= 0.0:
            raise CameraError(f"Camera.intrinsics = {self.intrinsics}: give focal lengths above 0")

    @checked(CameraError)
    def decimated(self, factor: Count) -> Self:
        """The camera of images of which one pixel is a square of ``factor`` pixels a side."""
        fx, fy, cx, cy = self.intrinsics
        off = 0.5 * (factor - 1)
        return replace(
            self,
            intrinsics=(fx / factor, fy / factor, (cx - off) / factor, (cy - off) / factor),
            width=self.width // factor,
            height=self.height // factor,
        )

    @checked(CameraError)
    def cropped(self, rows: slice, columns: slice) -> Self:
        """The camera of a part of its images."""
        (top, bottom, _), (left, right, _) = rows.indices(self.height), columns.indices(self.width)
        fx, fy, cx, cy = self.intrinsics
        intrinsics = (fx, fy, cx - left, cy - top)
        return replace(self, intrinsics=intrinsics, width=right - left, height=bottom - top)

    @checked(CameraError)
    def pixels(self, points_C: Annotated[Array, CLOUD]) -> tuple[Array, Array]:
        """Columns and rows of points (n, 3) in the camera's frame, shape (n,) each [px]."""
        return project(points_C, self.intrinsics)

    @checked(CameraError)
    def rays(self, u: Annotated[ArrayLike, _PIXELS], v: Annotated[ArrayLike, _PIXELS]) -> Array:
        """Lines of sight of pixels in columns u (n,) and rows v (n,), shape (n, 3), with z = 1."""
        fx, fy, cx, cy = self.intrinsics
        x, y = (np.asarray(u) - cx) / fx, (np.asarray(v) - cy) / fy
        return np.stack([x, y, np.ones_like(x)], axis=1)

    @checked(CameraError)
    def in_image(self, points_C: Annotated[Array, CLOUD]) -> Mask:
        """Mask of points (n, 3) inside the image and beyond the least depth, shape (n,)."""
        return np.asarray((self.to_border(points_C) > 1.0) & (points_C[:, 2] > self.near))

    @checked(CameraError)
    def to_border(self, points_C: Annotated[Array, CLOUD]) -> Array:
        """Distance of points (n, 3) to the image border, negative outside, shape (n,) [px]."""
        u, v = self.pixels(points_C)
        across = np.minimum(u, self.width - 1 - u)
        return np.asarray(np.minimum(across, np.minimum(v, self.height - 1 - v)))


@checked(CameraError)
def stereo_deviation(focal_length: Positive, baseline: Positive = BASELINE) -> float:
    """Coefficient of z^2 in the standard deviation of a stereo camera's depth z [1/m].

    ``SUBPIXEL / (f B)``, with the focal length f [px] of the images that are matched and the
    distance B of the imagers [m].
    """
    return SUBPIXEL / (focal_length * baseline)


def project(points_C: Array, intrinsics: tuple[float, float, float, float]) -> tuple[Array, Array]:
    """Columns and rows of points (n, 3) in a camera's frame [m], by fx, fy, cx, cy, (n,) each [px].

    Those behind the camera project to somewhere far off; whoever may have such asks for their z.
    """
    fx, fy, cx, cy = intrinsics
    z = np.maximum(points_C[:, 2], 1e-6)
    return fx * points_C[:, 0] / z + cx, fy * points_C[:, 1] / z + cy


def unproject(depth: Array, intrinsics: tuple[float, float, float, float]) -> Array:
    """Points (3, h, w) in a camera's frame of a depth image (h, w), by fx, fy, cx, cy [px].

    Where the depth is not finite, they are not.
    """
    fx, fy, cx, cy = intrinsics
    v, u = np.indices(depth.shape)
    with np.errstate(invalid="ignore"):  # zero times infinity
        return np.stack([(u - cx) / fx * depth, (v - cy) / fy * depth, depth])


def looking_along(direction: Array) -> Array:
    """A rotation whose z axis is along a direction (3,), as columns, shape (3, 3)."""
    z = direction / max(float(np.linalg.norm(direction)), 1e-12)
    return np.stack([*perpendiculars(z), z], axis=1)


def projected(points: Array, p_OC: Array, R_OC: Array) -> tuple[Array, Array]:
    """Positions (n, 2) in the plane z = 1 and depths (n,) [m] of points seen by a camera."""
    in_camera = (points - p_OC) @ R_OC
    depth = np.maximum(in_camera[:, 2], 1e-3)  # the camera is not inside the object
    return in_camera[:, :2] / depth[:, None], depth
