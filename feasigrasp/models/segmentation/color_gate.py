"""Color gate: pixels of a given hue, such as those of a glove or a belt."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Mask

#: A pixel is of a hue that is no farther from it than this [deg].
_TOLERANCE_DEG = 20.0
#: A pixel that is paler than this has no hue that could be relied on, nor one darker than that.
_LEAST_SATURATION, _LEAST_VALUE = 0.35, 0.06


def in_color_gate(color: NDArray[np.uint8], hue_deg: float) -> Mask:
    """Mask of pixels with a hue, independent of brightness.

    Args:
        color: Red, green and blue of each pixel in [0, 255], and more channels, which do not count,
            shape (height, width, >= 3).
        hue_deg: The hue [deg]: 0 is red, 120 green, 240 blue.

    Returns:
        Row by row, shape (height * width,).
    """
    rgb = color.reshape(-1, color.shape[-1])[:, :3].astype(np.float32) / 255.0
    red, green, blue = rgb.T
    value, least = rgb.max(axis=1), rgb.min(axis=1)
    # The angle of the colour about the grey axis; that of HSV differs by a degree at most.
    angle = np.arctan2(np.sqrt(3.0) * (green - blue), 2.0 * red - green - blue)
    off = np.abs((np.rad2deg(angle) - hue_deg + 180.0) % 360.0 - 180.0)
    vivid = value - least > _LEAST_SATURATION * np.maximum(value, _LEAST_VALUE)
    return np.asarray((off < _TOLERANCE_DEG) & vivid & (value > _LEAST_VALUE))
