"""Noise model of a stereo depth camera: disparity noise, quantization, dropouts at edges.

A camera like the RealSense D435 measures the disparity ``delta = f B / z`` between its two images;
what goes wrong, goes wrong in disparity:

- its subpixel error s gives an axial error that grows with the square of the distance,
  ``sigma_z = z^2 s / (f B)`` (Intel, "Best-known methods for tuning the D400 series"; s = 0.08 px,
  and 0.032 px at best, librealsense issue 3904); on a surface seen at an angle it is larger by one
  over the cosine, since the texture in a matched window is foreshortened;
- most of it stays while camera and surface do: averages of 50 images are as wavy as one
  (librealsense issues 10873, 1375). See `feasigrasp.models.sensors.camera_errors`;
- every camera has a scale and a bias of its own, within the accuracy of its data sheet: 2 % at 2 m
  for a D435, 1.4 % at 0.2 m and 2 % at 0.5 m for a D405;
- it is found in steps of 1/32 px, and the depth is handed out in whole millimetres;
- at the edge of an object the matched window shows two surfaces: the pixel is lost, or "flies"
  anywhere between them;
- beside it disparities are smeared from one surface to the other: in a sequence of a RealSense
  (lagadic/visp-images, ``rbt``) at 7 to 29 % of the jumps by 5 cm or more, mostly over 1 to 3
  pixels of 640 x 480;
- the search for matches ends at a largest disparity: what is nearer has no depth, and no pixel
  flies beyond the two ends of the depth range;
- a surface seen at a grazing angle gives no match;
- where the image moves during an exposure, edges are smeared: pixels farther from the edge than the
  next one are lost or fly as well;
- now and then an image does not arrive.

Windows of neighbouring pixels overlap, so that their noise is correlated. `DepthNoise.apply` alone
draws all of it anew for every image; with `FixedErrors` a share of it is the same in all.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d, maximum_filter, uniform_filter

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.choices import key
from feasigrasp.models.quantities import ArrayOf, Bound, NotNegative, Positive
from feasigrasp.models.sensors.depth_kernels import (
    cosine_kernel,
    edges_kernel,
    measure_kernel,
    smear_kernel,
)


class FixedErrors(NamedTuple):
    """Errors of an image of (h, w) pixels that stay while neither camera nor surfaces move.

    Attributes:
        disparity: By pixel, in standard deviations of the disparity, shape (h, w).
        holes: Mask of pixels without a match, shape (h, w).
        scale: Of all depths.
        bias: Of all disparities [px].
    """

    disparity: Array
    holes: Mask
    scale: float
    bias: float


@dataclass(frozen=True)
class DepthNoise:
    """The errors of a stereo depth camera; the defaults are those of a RealSense D435.

    Attributes:
        baseline: Distance B between the two imagers [m].
        subpixel: Standard deviation of the disparity [px].
        disparity_step: Smallest difference of two disparities [px]; 0 for any.
        depth_step: Smallest difference of two depths handed out [m]; 0 for any.
        edge_disparity: Neighbouring pixels whose disparities differ by more are an edge [px].
        flying: Share of the edge pixels that fly between the two surfaces.
        edge_missing: Share of the edge pixels that are lost.
        grazing_start_deg: Angle between line of sight and normal above which pixels get lost [deg].
        grazing_end_deg: Angle at which all are lost [deg]; the share grows linearly in between.
        correlation: Width (standard deviation) of the window over which disparities are averaged
            [px]; 0 for noise that is independent from pixel to pixel. The noise of one pixel stays
            what ``subpixel`` says.
        fixed: Share of the variance of the disparity that stays: half of it with the pixel, half
            with the point of the surface.
        texture: Correlation length of the part that stays with the surface [m].
        scale_error: Standard deviation of the scale of depths, over cameras; 1 is 100 %.
        bias: Standard deviation of the bias of disparities, over cameras [px].
        holes: Multiple of the share of pixels that a material loses, see `Material`.
        motion_blur: How many more pixels beside an edge are edge pixels [px]: the way of the image
            during an exposure. At 0.2 m/s, 0.3 m and 10 ms a camera with f = 220 px moves by 1.5.
        smear: Width of the window that disparities are averaged over at edges [px]; below 2 none.
            Perception by depth then drops the pixels between two surfaces.
        dropped: Share of the images that do not arrive: no pixel of theirs has a depth.
        decimation: How many of the matcher's pixels, in which disparities are, are one of the
            image, along each axis. Intel advises to match at 848 x 480 ("Tuning depth cameras").
    """

    baseline: Positive = key(0.05, 0.001, 1.0, "m")
    subpixel: NotNegative = key(0.08, 0.0, 10.0, "px")
    disparity_step: NotNegative = key(1.0 / 32.0, 0.0, 10.0, "px")
    depth_step: NotNegative = key(0.001, 0.0, 0.1, "m")
    edge_disparity: Positive = key(1.0, 0.01, 1000.0, "px")
    flying: NotNegative = key(0.3, 0.0, 1.0)
    edge_missing: NotNegative = key(0.3, 0.0, 1.0)
    grazing_start_deg: NotNegative = key(65.0, 0.0, 180.0, "deg")
    grazing_end_deg: NotNegative = key(85.0, 0.0, 180.0, "deg")
    correlation: NotNegative = key(1.0, 0.0, 20.0, "px")
    fixed: NotNegative = key(0.75, 0.0, 1.0)
    texture: NotNegative = key(0.004, 0.0005, 0.1, "m")
    scale_error: NotNegative = key(0.005, 0.0, 0.1)
    bias: NotNegative = key(0.05, 0.0, 10.0, "px")
    holes: NotNegative = key(1.0, 0.0, 10.0)
    motion_blur: NotNegative = key(0.0, 0.0, 20.0, "px")
    smear: NotNegative = key(0.0, 0.0, 20.0, "px")
    dropped: NotNegative = key(0.0, 0.0, 1.0)
    decimation: NotNegative = key(1.0, 1.0, 8.0)

    def __post_init__(self) -> None:
        """Raises CameraError for a parameter out of range."""
        check_fields(self, CameraError)
        if self.flying + self.edge_missing > 1.0:
            raise CameraError(
                f"DepthNoise.flying = {self.flying} and edge_missing = {self.edge_missing} are "
                "shares of the same pixels; together they can be 1 at most"
            )
        if self.dropped > 1.0:
            raise CameraError(f"DepthNoise.dropped = {self.dropped} is a share; give 1 at most")
        if not self.grazing_start_deg < self.grazing_end_deg:
            raise CameraError(
                f"DepthNoise.grazing_start_deg = {self.grazing_start_deg} must be less than "
                f"grazing_end_deg = {self.grazing_end_deg}"
            )

    @checked(CameraError)
    def scaled(self, factor: NotNegative) -> Self:
        """A camera whose noise, scale, bias and holes are ``factor`` times as large."""
        sizes = ("subpixel", "scale_error", "bias", "holes")
        return replace(self, **{name: factor * getattr(self, name) for name in sizes})

    @checked(CameraError)
    def apply(
        self,
        depth: NDArray[Any],
        intrinsics: Annotated[ArrayLike, ArrayOf(("...",), "px")],
        rng: np.random.Generator,
        *,
        near: NotNegative = 0.0,
        far: Bound = np.inf,
        fixed: FixedErrors | None = None,
    ) -> NDArray[Any]:
        """The depth image that the camera would hand out.

        Args:
            depth: True depths along the optical axis, shape (h, w) [m]. As in Drake's images, 0 is
                too near and infinity too far; those and NaN stay as they are.
            intrinsics: Matrix K, shape (3, 3), or (fx, fy, cx, cy) [px].
            rng: Source of all chance; three draws per pixel, and one more if images are dropped, so
                equal seeds give equal images.
            near: Least depth that the camera measures [m]. What is too near stands there, as far
                as its neighbours are concerned: where a surface just leaves the range there is no
                edge, and before a surface behind, pixels fly towards it. With 0 it is not known
                where, and next to what is too near no pixel flies.
            far: Largest depth that it measures [m].
            fixed: Errors that are the same in every image; None for an image of its own.

        Returns:
            A new image of the same floating-point type (float64 if it had none); 0 where the pixel
            was lost or is measured before ``near``, infinity where it is measured beyond ``far``.

        Raises:
            CameraError: If the image has no two dimensions, or the intrinsics no focal length.
        """
        image = np.asarray(depth)
        if image.ndim != 2 or image.dtype.kind not in "fiu":
            raise CameraError(
                f"depth is an image of {image.dtype} with shape {image.shape}; give (h, w) numbers"
            )
        fx, fy, cx, cy = checked_intrinsics(intrinsics)
        z = image.astype(float)
        kind = image.dtype if image.dtype.kind == "f" else np.dtype(float)
        valid = np.isfinite(z) & (z > 0.0)
        inverse = np.divide(1.0, z, out=np.zeros_like(z), where=valid)
        scale = fx * self.decimation * self.baseline
        fate, mix = rng.random(z.shape), rng.random(z.shape)
        error = correlated(rng.standard_normal(z.shape), self.correlation)
        gain, bias = 1.0, 0.0
        if fixed is not None:
            error = math.sqrt(1.0 - self.fixed) * error + fixed.disparity
            gain, bias = fixed.scale, fixed.bias
        if self.dropped > 0.0 and rng.random() < self.dropped:
            return np.zeros(z.shape, dtype=kind)

        nearest = 1.0 / near if near > 0.0 else np.nan
        beside = np.where(z <= 0.0, nearest, inverse)
        threshold = self.edge_disparity / scale
        partner, edge = np.empty_like(z), np.empty(z.shape, dtype=bool)
        edges_kernel(beside, threshold, partner, edge)
        for _ in range(round(self.motion_blur)):
            partner, edge = smear_kernel(beside, threshold, partner, edge)
        cosine, measured = np.empty_like(z), np.empty(z.shape, dtype=kind)
        cosine_kernel(inverse, valid, (fx, fy, cx, cy), cosine)
        if self.smear >= 2.0:
            inverse = _smeared(inverse, valid, edge, round(self.smear))
        noise = scale, gain, bias, self.subpixel, self.disparity_step, self.depth_step
        shares = self.flying, self.edge_missing, self.grazing_start_deg, self.grazing_end_deg
        measure_kernel(
            *(z, inverse, valid, partner, edge, cosine, (fate, mix, error)),
            *(tuple(map(float, noise + shares)), (float(near), float(far)), measured),
        )
        if fixed is not None:
            measured[fixed.holes & valid] = 0.0
        return measured


def _smeared(inverse: Array, valid: Mask, edge: Mask, width: int) -> Array:
    """Inverse depths, at edges their means over windows of ``width`` pixels of what is measured."""
    share = uniform_filter(valid.astype(float), width)
    mean = uniform_filter(inverse, width) / np.maximum(share, 1e-6)
    at_edge = valid & maximum_filter(edge, width)
    return np.where(at_edge, mean, inverse)


def checked_intrinsics(intrinsics: ArrayLike) -> tuple[float, float, float, float]:
    """``(fx, fy, cx, cy)`` [px] from those or from a matrix K (3, 3).

    Raises:
        CameraError: If it is neither, or a focal length is not positive.
    """
    given = np.asarray(intrinsics, dtype=float)
    if given.shape == (3, 3):
        given = given[[0, 1, 0, 1], [0, 1, 2, 2]]
    if given.shape != (4,) or not np.isfinite(given).all() or not (given[:2] > 0.0).all():
        raise CameraError(
            f"intrinsics {np.asarray(intrinsics).tolist()}: give K (3, 3) or (fx, fy, cx, cy) with "
            "positive focal lengths in pixels"
        )
    fx, fy, cx, cy = given.tolist()
    return fx, fy, cx, cy


def correlated(white: Array, width: float) -> Array:
    """Noise of the same variance, averaged over a window of that standard deviation [px]."""
    if width == 0.0:
        return white
    impulse = np.zeros(2 * int(4.0 * width + 0.5) + 3)
    impulse[len(impulse) // 2] = 1.0
    deviation = np.square(gaussian_filter1d(impulse, width)).sum()  # of both axes
    return np.asarray(gaussian_filter(white, width, mode="wrap") / deviation)
