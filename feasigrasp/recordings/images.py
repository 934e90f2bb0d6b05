"""Reads depth images and masks, and rejects implausible ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import InputError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.quantities import Count, Positive

#: A median depth beyond these is a wrong unit [m]: a D405 measures from 0.07 m, and depth cameras
#: of robots to about 10 m (data sheets).
_PLAUSIBLE = 0.02, 20.0


@checked(InputError)
def read_depth(file: str | Path, unit: Positive = 1e-3) -> Array:
    """Reads a depth image.

    Args:
        file: A 16-bit PNG, or another picture of whole numbers with more than 8 bits.
        unit: Metres per unit.

    Returns:
        Depths along the optical axis, 0 where nothing was measured, shape (height, width) [m].

    Raises:
        InputError: It is no picture of one channel, or has 8 bits.
    """
    pixels = _pixels(Path(file))
    if pixels.dtype.kind not in "iu" or pixels.dtype.itemsize < 2:
        bits = 8 * pixels.dtype.itemsize
        raise InputError(
            f"{file} has {bits}-bit pixels ({pixels.dtype.name}), which hold no measured depth; "
            "save the raw depth as a 16-bit PNG"
        )
    return unit * pixels.astype(float)


@checked(InputError)
def read_mask(file: str | Path, shape: tuple[Count, Count]) -> Mask:
    """Reads which pixels show the object: those other than zero.

    Args:
        file: A picture of one channel.
        shape: Height and width of the depth image that it goes with.

    Raises:
        InputError: It is no such picture, or has another size.
    """
    pixels = _pixels(Path(file))
    check_size(file, pixels.shape, shape)
    return np.asarray(pixels > 0)


def check_size(file: str | Path, shape: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Refuses a picture of another size (height, width) than that of the camera.

    Raises:
        InputError: It has another one.
    """
    if shape != expected:
        raise InputError(
            f"{file} has {shape[1]} x {shape[0]} pixels, but the depth image "
            f"{expected[1]} x {expected[0]}"
        )


def check_unit(file: str | Path, depth: Array, unit: float) -> None:
    """Rejects a depth image in another unit than stated.

    Args:
        file: Where it is from.
        depth: Shape (height, width) [m].
        unit: Metres per unit that it was read with.

    Raises:
        InputError: Its median depth is nothing that a depth camera measures.
    """
    measured = depth[depth > 0.0]
    if measured.size == 0 or _PLAUSIBLE[0] <= (middle := np.median(measured)) <= _PLAUSIBLE[1]:
        return
    scale = 1e3 * unit  # as others give it: metres per unit, or units per metre
    meant = {"metres per unit": 1e3 * scale, "units per metre": 1e3 / scale}
    fits = [
        f"; if that is {what}, depth_scale is {value:g}"
        for what, value in meant.items()
        if _PLAUSIBLE[0] <= middle * value / scale <= _PLAUSIBLE[1]
    ]
    raise InputError(
        f"{file}: its median depth is {middle:.2g} m with depth_scale {scale:g} [mm per unit], "
        f"which no depth camera measures{fits[0] if fits else '; mend depth_scale'}"
    )


def _pixels(file: Path) -> NDArray[Any]:
    """A picture of one channel, shape (h, w)."""
    if not file.is_file():
        raise InputError(f"there is no file {file}")
    try:
        with Image.open(file) as image:
            pixels = np.asarray(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(f"{file} is no whole picture ({error})") from error
    if pixels.ndim != 2:
        raise InputError(f"{file} has {pixels.shape[-1]} channels; a depth image or mask has one")
    return pixels
