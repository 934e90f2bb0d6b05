"""Errors of a depth camera that stay: scale, bias, patterns, holes, and those of its calibration.

A stereo matcher errs by what it sees. Lens errors that rectification leaves are fixed to the pixel
(librealsense issue 3210), and what the texture in a window misleads it by to the surface. Both are
smooth Gaussian fields of variance 1, drawn once per camera:

- ``e(u, v)`` on the pixels;
- ``d . F(p / l)`` on a surface: F is a field of three components in the frame of the body that the
  point p is of (the object, or else the world), l its correlation length, and d the unit vector
  from there to the camera. From two directions at an angle a the errors are correlated by cos a:
  they stand still as long as camera and body do, and change slowly as the view does.

A material loses the share of a surface on which a second such field, of the length of its holes, is
largest: patches, not single pixels.

Left out: dependence on light, exposure and the true texture; the other bodies that move (links of
the arm, a carrier, a distractor) are of the world's field; a transparent surface shows nothing of
what is behind it; the field repeats, after 43 correlation lengths.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

from feasigrasp.errors import CameraError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Floats, Mask
from feasigrasp.models.choices import key
from feasigrasp.models.compiled import compiled
from feasigrasp.models.quantities import POSE, ArrayOf, Count, NotNegative, Positive, Share, Whole
from feasigrasp.models.sensors.depth_noise import (
    DepthNoise,
    FixedErrors,
    checked_intrinsics,
    correlated,
)


@dataclass(frozen=True)
class Material:
    """A surface as a stereo camera sees it.

    Attributes:
        holes: Share of the surface on which it finds no match.
        length: Correlation length of the holes [m].
    """

    holes: Share
    length: Positive

    def __post_init__(self) -> None:
        check_fields(self, CameraError)


#: Materials by name. Shares and lengths are choices, guessed; of the literature only the order:
#: matt surfaces are whole, dark and shiny ones have holes, transparent ones are mostly lost
#: (Halmetschlager-Funek et al., "An empirical evaluation of ten depth cameras", RAM 2019; not
#: verified at the source).
MATERIALS = {
    "matt": Material(0.0, 0.004),
    "dark": Material(0.1, 0.006),
    "shiny": Material(0.2, 0.008),
    "transparent": Material(0.6, 0.012),
}
#: Nodes along an axis after which the field on surfaces repeats, a power of two; cells per
#: correlation length. Source: numerical.
_NODES, _CELLS = 64, 1.5
#: Where the field is read for holes, so that they have nothing to do with the errors [cells].
#: Source: numerical.
_APART = 17.3
#: Makes the seed of a camera another than those of its images. Source: layout.
_CAMERA = 2**41


class CameraErrors:
    """The errors of one camera that stay."""

    @checked(CameraError)
    def __init__(self, noise: DepthNoise, seed: Whole, size: tuple[Count, Count]) -> None:
        """Draws errors of such sizes, by the camera's seed, for images of a height and width [px].

        Raises CameraError for an argument of another type or range.
        """
        rng = np.random.default_rng([seed, _CAMERA])
        self._noise = noise
        self.scale = 1.0 + noise.scale_error * float(rng.standard_normal())
        self.bias = noise.bias * float(rng.standard_normal())
        # The window is that of the matcher, at a third of the full resolution: 3 px; guessed.
        self._pattern = correlated(rng.standard_normal(size), 3.0)
        self._field = _periodic_field(rng)

    @checked(CameraError)
    def fixed(
        self,
        depth: Annotated[Array, ArrayOf(("h", "w"), "m", finite=False)],
        intrinsics: Annotated[ArrayLike, ArrayOf(("...",), "px")],
        poses: tuple[Annotated[Array, POSE], Annotated[Array, POSE]],
        on_object: Annotated[Mask, ArrayOf(("h", "w"), dtype=np.bool_)],
        material: Material,
    ) -> FixedErrors:
        """The errors of an image.

        Args:
            depth: True depths, shape (h, w) [m].
            intrinsics: fx, fy, cx, cy or a matrix K (3, 3) [px].
            poses: Of the camera in the world and in the object, X_WC and X_OC, shape (4, 4) each.
            on_object: Which pixels show the object, shape (h, w).
            material: Of the object; the world is matt.

        Raises:
            CameraError: An argument of another type, shape or range, or an image of another size.
        """
        if depth.shape != self._pattern.shape:
            raise CameraError(
                f"CameraErrors.fixed: depth has shape {depth.shape}; give {self._pattern.shape}"
            )
        materials = (MATERIALS["matt"], material)
        share = np.clip([self._noise.holes * m.holes for m in materials], 0.0, 1.0)
        lengths = np.array([(self._noise.texture, m.length) for m in materials])
        error, holes = self._pattern.copy(), np.zeros(depth.shape, dtype=bool)
        _surface_kernel(
            depth,
            on_object,
            checked_intrinsics(intrinsics),
            np.array(poses, dtype=float),
            (self._field, _CELLS / lengths, -ndtri(share)),
            error,
            holes,
        )
        error *= math.sqrt(0.5 * self._noise.fixed)
        return FixedErrors(error, holes, self.scale, self.bias)


@dataclass(frozen=True)
class HandEyeError:
    """Residual error of the hand-eye calibration: a constant pose error in the camera frame.

    Attributes:
        hand_eye_position: How far off its place is [m].
        hand_eye_angle_deg: By which angle its orientation is off [deg].
    """

    hand_eye_position: NotNegative = key(0.0, 0.0, 0.1, "m")
    hand_eye_angle_deg: NotNegative = key(0.0, 0.0, 30.0, "deg")

    def __post_init__(self) -> None:
        """Raises CameraError for a size that is negative or not finite."""
        check_fields(self, CameraError)

    def scaled(self, factor: float) -> Self:
        """A calibration that errs ``factor`` times as much."""
        return type(self)(**{name: factor * value for name, value in vars(self).items()})

    def draw(self, rng: np.random.Generator) -> Array:
        """The calibrated pose in the frame of the true camera, X_CB, (4, 4).

        The directions of both errors are drawn; the sizes are what they are.
        """
        axes = rng.standard_normal((2, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        X_CB = np.eye(4)
        turn = np.deg2rad(self.hand_eye_angle_deg) * axes[0]
        X_CB[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
        X_CB[:3, 3] = self.hand_eye_position * axes[1]
        return X_CB


def _periodic_field(rng: np.random.Generator) -> Floats:
    """Three smooth fields of variance 1 where they are interpolated, shape (`_NODES`, ..., 3)."""
    white = rng.standard_normal((_NODES, _NODES, _NODES, 3))
    field = gaussian_filter(white, _CELLS, mode="wrap", axes=(0, 1, 2))
    field /= field.std(axis=(0, 1, 2))
    beside = float(np.mean(field * np.roll(field, 1, axis=0)))
    # Between two nodes at the share a the variance is 1 - 2 a (1 - a) (1 - beside), per axis.
    field /= (1.0 - (1.0 - beside) / 3.0) ** 1.5
    return np.ascontiguousarray(field, dtype=np.float32)


@compiled(nogil=True)
def _surface_kernel(depth, on_object, intrinsics, poses, fields, error, holes):
    """Adds the errors of surfaces to those of pixels, marks the holes; see `CameraErrors.fixed`.

    ``fields`` are the field; cells per metre of errors and of holes, for world and object, (2, 2);
    least value of the field where there is a hole, (2,).
    """
    fx, fy, cx, cy = intrinsics
    field, cells, least = fields
    h, w = depth.shape
    p, d = np.empty(3), np.empty(3)
    for i in range(h):
        for j in range(w):
            z = depth[i, j]
            if not (np.isfinite(z) and z > 0.0):
                continue
            k = 1 if on_object[i, j] else 0
            X = poses[k]
            x, y = (j - cx) / fx * z, (i - cy) / fy * z
            far = math.sqrt(x * x + y * y + z * z)
            for a in range(3):
                way = X[a, 0] * x + X[a, 1] * y + X[a, 2] * z
                p[a], d[a] = X[a, 3] + way, -way / far
            error[i, j] += _along(field, p, d, cells[k, 0], 0.0)
            if least[k] < np.inf:
                holes[i, j] = _along(field, p, d, cells[k, 1], _APART) > least[k]


@compiled(forceinline=True)
def _along(field, p, d, cells, apart):
    """Component along d of the field at p, linear between its nodes."""
    x, y, z = cells * p[0] + apart, cells * p[1] + apart, cells * p[2] + apart
    i, j, k = int(math.floor(x)), int(math.floor(y)), int(math.floor(z))
    a, b, c = x - i, y - j, z - k
    total = 0.0
    for u in range(2):
        for v in range(2):
            weight = (a if u else 1.0 - a) * (b if v else 1.0 - b)
            row = field[(i + u) & (_NODES - 1), (j + v) & (_NODES - 1)]
            near, far = row[k & (_NODES - 1)], row[(k + 1) & (_NODES - 1)]
            for n in range(3):
                total += weight * d[n] * ((1.0 - c) * near[n] + c * far[n])
    return total
