"""Depth discontinuities: pixels with mixed depth, and borders where an object may continue.

What a view shows nothing of is not all free space: depths are lost on steep and dark surfaces, what
is too near is not measured, something may be before the object, and the picture ends.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.clouds.checks import least_smear

#: Points of neighbouring pixels on an object that are farther apart lie on different surfaces [m].
#: Source: guessed.
EDGE_JUMP = 0.02
#: A mask of fewer pixels shows too little of an object, and is grown by this [pixels]. Source:
#: guessed.
SCANTY, GROWTH = 150, 10


def edge_pixels(points: NDArray[np.floating], seen: Mask, of_body: Mask, jump: float) -> Mask:
    """Pixels with a neighbour, of the four, that shows another surface.

    That is one whose point is farther away than ``jump`` [m], or one without a point that does not
    belong to the body. (A lost pixel amid the body is a hole in the measurement, not an edge.)
    Points are (3, h, w) [m]; the masks, of pixels with a point and of those of the body, (h, w).
    """
    edge = np.zeros(seen.shape, dtype=bool)
    for one, next_ in ((np.s_[:-1, :], np.s_[1:, :]), (np.s_[:, :-1], np.s_[:, 1:])):
        with np.errstate(invalid="ignore"):  # infinity minus infinity, where nothing was measured
            square = np.square(points[:, *next_] - points[:, *one]).sum(axis=0)
        apart = seen[one] & seen[next_] & (square > jump**2)
        edge[one] |= apart | ~(seen[next_] | of_body[next_])
        edge[next_] |= apart | ~(seen[one] | of_body[one])
    return edge


def smeared_pixels(depth: Array, camera: Camera) -> Mask:
    """Pixels where a stereo camera smears from one surface to the next, shape (h, w).

    Of its two neighbours in a row or column one is nearer and the other one farther, by more than
    `least_smear`. The depth (h, w) [m] is 0 or not finite where nothing was measured.
    """
    z = np.where(np.isfinite(depth) & (depth > 0.0), depth, np.nan)
    least = least_smear(z, 1.0 / min(camera.intrinsics[:2]), camera.depth_noise)
    smeared = np.zeros(z.shape, dtype=bool)
    with np.errstate(invalid="ignore"):  # NaN where nothing was measured
        for image, of, limit in ((smeared, z, least), (smeared.T, z.T, least.T)):
            middle = of[1:-1]
            near, far = np.minimum(of[2:], of[:-2]), np.maximum(of[2:], of[:-2])
            image[1:-1] |= np.minimum(far - middle, middle - near) > limit[1:-1]
    return smeared


def grown_mask(points: NDArray[np.floating], mask: Mask, free: Mask, jump: float) -> Mask:
    """A mask of too few pixels, grown along the surface that it is on; any other as it is.

    It grows up to the edges of the surface, and by `GROWTH` pixels at most: so one that misses the
    object's rim is mended, and one that lies on a wall does not become the wall. Of points (3, h,
    w) [m], not finite where nothing was measured; pixels taken for the object, and those not known
    to show anything else, (h, w) each; ``jump`` as in `edge_pixels` [m].
    """
    if not 0 < np.count_nonzero(mask) < SCANTY:
        return mask
    seen = np.isfinite(points).all(axis=0)
    surface = seen & (free | mask) & ~edge_pixels(points, seen, mask, jump)
    return mask | binary_dilation(mask & surface, iterations=GROWTH, mask=surface)


@dataclass(frozen=True, eq=False)
class Outline(Frozen):
    """Borders of a view beyond which the object may continue.

    Attributes:
        unmeasured: Lines of sight to parts of it without a point, shape (n, 3), of any length, in
            the axes of the points that this goes with.
        hidden: Lines of sight to what is before it, or beside it and before the rest, shape (m, 3).
        whole: Whether the picture does not end amid the object.
    """

    unmeasured: Array
    hidden: Array
    whole: bool = True

    def __post_init__(self) -> None:
        unmeasured, hidden = np.array(self.unmeasured, float), np.array(self.hidden, float)
        self._freeze(unmeasured=unmeasured.reshape(-1, 3), hidden=hidden.reshape(-1, 3))

    def turned(self, R: Array) -> "Outline":
        """The outline in other axes, after a rotation R (3, 3)."""
        return Outline(self.unmeasured @ R.T, self.hidden @ R.T, self.whole)


def outline(
    kept: Mask, of_body: Mask, hiding: Mask, corner: tuple[int, int], camera: Camera
) -> Outline:
    """The outline of a body, in the axes of the camera, z forward.

    By masks (h, w) of a part of the image that contains all of the body, from a corner (row,
    column) on: pixels of which there is a point, those that show the body, with a depth or without,
    and those that show what is before it.
    """
    # The eight neighbours of a point are pixels at an edge, which silhouettes allow for.
    lost = of_body & ~binary_dilation(kept, np.ones((3, 3), dtype=bool))
    unmeasured, hidden = (
        camera.rays(columns + corner[1], rows + corner[0])
        for rows, columns in map(np.nonzero, (lost, hiding))
    )
    # A silhouette of whose rim the picture's border is a larger share is not whole. Source:
    # guessed.
    return Outline(unmeasured, hidden, whole=bool(_cut(of_body) <= 0.05))


def _cut(of_body: Mask) -> float:
    """The share of a body's rim that lies at the border of the array, in [0, 1]."""
    if not of_body.any():
        return 0.0
    padded = np.pad(of_body.astype(np.int8), 1)
    rim = sum(np.count_nonzero(np.diff(padded, axis=axis)) for axis in (0, 1))
    border = sum(np.count_nonzero(side) for side in (*of_body[[0, -1]], *of_body.T[[0, -1]]))
    return border / rim
