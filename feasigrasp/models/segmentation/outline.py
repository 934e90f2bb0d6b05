"""Where an object may go on beside the points that a camera has of it.

What a view shows nothing of is not all free space: depths are lost on steep and dark surfaces, what
is too near is not measured, something may be before the object, and the picture ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera

_AROUND = np.ones((3, 3), dtype=bool)
#: A silhouette of whose rim the picture's border is a larger share is not whole.
_MAX_CUT = 0.05


@dataclass(frozen=True, eq=False)
class Outline(Frozen):
    """What a view leaves open.

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
        """Freezes the arrays."""
        for name in ("unmeasured", "hidden"):
            self._freeze(**{name: np.array(getattr(self, name), dtype=float).reshape(-1, 3)})

    def turned(self, R: Array) -> Outline:
        """The same in other axes, after a rotation R (3, 3)."""
        return Outline(self.unmeasured @ R.T, self.hidden @ R.T, self.whole)


def outline(
    kept: Mask, of_body: Mask, hiding: Mask, corner: tuple[int, int], camera: Camera
) -> Outline:
    """The outline of a body in a part of an image.

    Args:
        kept: Pixels of which there is a point, shape (h, w).
        of_body: Pixels that show the body, with a depth or without.
        hiding: Pixels that show what is before it.
        corner: Row and column in the image of the first pixel of these arrays, which contain all of
            the body.
        camera: The camera.

    Returns:
        In the camera's axes, z forward.
    """
    # The neighbours of a point are pixels at an edge, which silhouettes allow for.
    unmeasured = of_body & ~binary_dilation(kept, _AROUND)
    return Outline(
        _rays(unmeasured, corner, camera),
        _rays(hiding, corner, camera),
        whole=bool(_cut(of_body) <= _MAX_CUT),
    )


def _rays(mask: Mask, corner: tuple[int, int], camera: Camera) -> Array:
    row, column = np.nonzero(mask)
    fx, fy, cx, cy = camera.intrinsics
    x, y = (column + corner[1] - cx) / fx, (row + corner[0] - cy) / fy
    return np.stack([x, y, np.ones_like(x)], axis=1)


def _cut(of_body: Mask) -> float:
    """The share of a body's rim that lies at the border of the array, in [0, 1]."""
    if not of_body.any():
        return 0.0
    padded = np.pad(of_body.astype(np.int8), 1)
    rim = sum(np.count_nonzero(np.diff(padded, axis=axis)) for axis in (0, 1))
    border = sum(np.count_nonzero(side) for side in (*of_body[[0, -1]], *of_body.T[[0, -1]]))
    return border / rim
