"""Noise model of a stereo depth camera: disparity noise, quantization, dropouts at edges.

A camera like the RealSense D435 measures the disparity ``delta = f B / z`` between its two images;
what goes wrong, goes wrong in disparity:

- its subpixel error s gives an axial error that grows with the square of the distance,
  ``sigma_z = z^2 s / (f B)`` (Intel, "Best-known methods for tuning the D400 series"; s = 0.08 px);
- it is found in steps of 1/32 px, and the depth is handed out in whole millimetres;
- at the edge of an object the matched window shows two surfaces: the pixel is lost, or "flies"
  anywhere between them;
- the search for matches ends at a largest disparity: what is nearer has no depth, and no pixel
  flies beyond the two ends of the depth range;
- a surface seen at a grazing angle gives no match;
- where the image moves during an exposure, edges are smeared: pixels farther from the edge than the
  next one are lost or fly as well;
- now and then an image does not arrive.

By default the noise is independent from pixel to pixel; that of a real camera is correlated over a
few pixels (``correlation``), since windows of neighbouring pixels overlap. A real camera loses
further pixels on surfaces that are black, shiny or without texture.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import key
from feasigrasp.models.compiled import compiled
from feasigrasp.models.quantities import ArrayOf, Bound, NotNegative, Positive


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
        motion_blur: How many more pixels beside an edge are edge pixels [px]: the way of the image
            during an exposure. At 0.2 m/s, 0.3 m and 10 ms a camera with f = 220 px moves by 1.5.
        dropped: Share of the images that do not arrive: no pixel of theirs has a depth.
    """

    baseline: float = key(0.05, 0.001, 1.0, "m")
    subpixel: float = key(0.08, 0.0, 10.0, "px")
    disparity_step: float = key(1.0 / 32.0, 0.0, 10.0, "px")
    depth_step: float = key(0.001, 0.0, 0.1, "m")
    edge_disparity: float = key(1.0, 0.01, 1000.0, "px")
    flying: float = key(0.3, 0.0, 1.0)
    edge_missing: float = key(0.3, 0.0, 1.0)
    grazing_start_deg: float = key(65.0, 0.0, 180.0, "deg")
    grazing_end_deg: float = key(85.0, 0.0, 180.0, "deg")
    correlation: float = key(0.0, 0.0, 20.0, "px")
    motion_blur: float = key(0.0, 0.0, 20.0, "px")
    dropped: float = key(0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        """Checks the parameters.

        Raises:
            CameraError: A parameter out of range.
        """
        check_fields(self, CameraError)
        for name in (field.name for field in fields(self)):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise CameraError(f"DepthNoise.{name} = {getattr(self, name)}; give 0 or more")
        for name in ("baseline", "edge_disparity"):
            if getattr(self, name) == 0.0:
                raise CameraError(f"DepthNoise.{name} = 0; give a positive number")
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
    def axial(self, focal_length: Positive) -> float:
        """Coefficient of z^2 in the standard deviation of a depth z [1/m], see above.

        Args:
            focal_length: f [px].
        """
        return self.subpixel / (focal_length * self.baseline)

    @checked(CameraError)
    def apply(
        self,
        depth: NDArray[Any],
        intrinsics: Annotated[ArrayLike, ArrayOf(("...",), "px")],
        rng: np.random.Generator,
        *,
        near: NotNegative = 0.0,
        far: Bound = np.inf,
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

        Returns:
            A new image of the same floating-point type (float64 if it had none); infinity where the
            pixel was lost or is measured beyond ``far``, 0 where it is measured before ``near``.

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
        scale = fx * self.baseline
        fate, mix = rng.random(z.shape), rng.random(z.shape)
        error = _correlated(rng.standard_normal(z.shape), self.correlation)
        if self.dropped > 0.0 and rng.random() < self.dropped:
            return np.full(z.shape, np.inf, dtype=kind)

        nearest = 1.0 / near if near > 0.0 else np.nan
        beside = np.where(z <= 0.0, nearest, inverse)
        threshold = self.edge_disparity / scale
        partner, edge = np.empty_like(z), np.empty(z.shape, dtype=bool)
        _edges_kernel(beside, threshold, partner, edge)
        for _ in range(round(self.motion_blur)):
            partner, edge = _smear_kernel(beside, threshold, partner, edge)
        cosine, measured = np.empty_like(z), np.empty(z.shape, dtype=kind)
        _cosine_kernel(inverse, valid, (fx, fy, cx, cy), cosine)
        noise = scale, self.subpixel, self.disparity_step, self.depth_step
        shares = self.flying, self.edge_missing, self.grazing_start_deg, self.grazing_end_deg
        _measure_kernel(
            *(z, inverse, valid, partner, edge, cosine, (fate, mix, error)),
            *(tuple(map(float, noise + shares)), (float(near), float(far)), measured),
        )
        return measured


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


def _correlated(white: Array, width: float) -> Array:
    """Noise of the same variance, averaged over a window of that standard deviation [px]."""
    if width == 0.0:
        return white
    impulse = np.zeros(2 * int(4.0 * width + 0.5) + 3)
    impulse[len(impulse) // 2] = 1.0
    deviation = np.square(gaussian_filter1d(impulse, width)).sum()  # of both axes
    return np.asarray(gaussian_filter(white, width, mode="wrap") / deviation)


@compiled(nogil=True)
def _edges_kernel(inverse, threshold, partner, edge):
    """The most different inverse depth among each pixel's four neighbours, and where it is an edge.

    A neighbour whose inverse depth is NaN is no partner.

    Images have shape (h, w); inverse depths are NaN where they are not known [1/m].

    Args:
        inverse: Inverse depths.
        threshold: Neighbours that differ by more are an edge [1/m].
        partner: Is given the inverse depth of the partner, its own where there is none.
        edge: Is given whether it is an edge.
    """
    h, w = inverse.shape
    for i in range(h):
        for j in range(w):
            own = inverse[i, j]
            other, most = own, 0.0
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                if 0 <= a < h and 0 <= b < w:
                    jump = abs(inverse[a, b] - own)
                    if jump > most:
                        other, most = inverse[a, b], jump
            partner[i, j], edge[i, j] = other, most > threshold


@compiled(nogil=True)
def _smear_kernel(inverse, threshold, partner, edge):
    """Partners and edge pixels, each edge wider by a pixel on the surface that it ends.

    Args:
        inverse: Inverse depths.
        threshold: As in `_edges_kernel`.
        partner: Partners up to here.
        edge: Edges up to here.

    Returns:
        Both anew.
    """
    h, w = inverse.shape
    wider, partners = edge.copy(), partner.copy()
    for i in range(h):
        for j in range(w):
            if edge[i, j]:
                continue
            for a, b in ((i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)):
                beside = 0 <= a < h and 0 <= b < w and edge[a, b]
                if beside and abs(inverse[a, b] - inverse[i, j]) <= threshold:
                    wider[i, j], partners[i, j] = True, partner[a, b]
                    break
    return partners, wider


@compiled(nogil=True)
def _cosine_kernel(inverse, valid, intrinsics, cosine):
    """Cosine of the angle between line of sight and normal, 1 where nothing was measured.

    On a plane the inverse depth is linear in the image, ``1/z = a x + b y + c`` with
    ``x = (u - cx) / fx`` and ``y = (v - cy) / fy``, and (a, b, c) is along its normal: exact for
    planes. Of the two differences to either side the smaller one counts, so that an edge does not
    look like a slope.

    Args:
        inverse: Inverse depths.
        valid: Where they are known.
        intrinsics: fx, fy, cx, cy [px].
        cosine: Is given the cosines.
    """
    fx, fy, cx, cy = intrinsics
    h, w = inverse.shape
    for i in range(h):
        y = (i - cy) / fy
        for j in range(w):
            if not valid[i, j]:
                cosine[i, j] = 1.0
                continue
            own = inverse[i, j]
            right, left, below, above = np.inf, np.inf, np.inf, np.inf
            if j + 1 < w and valid[i, j + 1]:
                right = inverse[i, j + 1] - own
            if j > 0 and valid[i, j - 1]:
                left = own - inverse[i, j - 1]
            if i + 1 < h and valid[i + 1, j]:
                below = inverse[i + 1, j] - own
            if i > 0 and valid[i - 1, j]:
                above = own - inverse[i - 1, j]
            x = (j - cx) / fx
            a, b = fx * _smaller(right, left), fy * _smaller(below, above)
            c = own - a * x - b * y
            length = math.sqrt((a * a + b * b + c * c) * (x * x + y * y + 1.0))
            cosine[i, j] = min(max(own / length, 0.0), 1.0)


@compiled(nogil=True)
def _smaller(after, before):
    """The difference that is smaller by its amount; 0 where neither is known."""
    smaller = after if abs(after) < abs(before) else before
    return smaller if math.isfinite(smaller) else 0.0


@compiled(nogil=True)
def _measure_kernel(z, inverse, valid, partner, edge, cosine, chance, noise, limits, measured):
    """What is measured of every pixel.

    Args:
        z: True depths [m].
        inverse: Inverse depths.
        valid: Where there is one.
        partner: Of `_edges_kernel`.
        edge: Of `_edges_kernel`.
        cosine: Of `_cosine_kernel`.
        chance: Three images: of a pixel's fate and what it is mixed of, uniform in [0, 1), and the
            error of its disparity, with standard deviation 1.
        noise: f B [px m], `DepthNoise.subpixel`, ``disparity_step``, ``depth_step``, ``flying``,
            ``edge_missing``, ``grazing_start_deg`` and ``grazing_end_deg``.
        limits: Least and largest depth that is measured [m].
        measured: Is given the depths, as `DepthNoise.apply` has them [m].
    """
    fate, mix, error = chance
    scale, subpixel, disparity_step, depth_step, flying, missing, start, end = noise
    near, far = limits
    h, w = z.shape
    for i in range(h):
        for j in range(w):
            if not valid[i, j]:
                measured[i, j] = z[i, j]
                continue
            lost = edge[i, j] and fate[i, j] < missing
            flies = edge[i, j] and not lost and fate[i, j] < missing + flying
            if start < 90.0 and not flies and not lost:
                # An edge pixel that flies is of no surface; elsewhere the draw is still unused.
                angle = math.degrees(math.acos(cosine[i, j]))
                lost = mix[i, j] < (angle - start) / (end - start)
            if lost:
                measured[i, j] = np.inf
                continue
            disparity = inverse[i, j]
            if flies:
                disparity += mix[i, j] * (partner[i, j] - inverse[i, j])
            disparity = scale * disparity + subpixel * error[i, j]
            if disparity_step > 0.0:
                disparity = disparity_step * np.rint(disparity / disparity_step)
            depth = scale / disparity if disparity > 0.0 else np.inf
            if depth_step > 0.0:
                depth = depth_step * np.rint(depth / depth_step)
            measured[i, j] = 0.0 if depth < near else (np.inf if depth > far else depth)
