"""Reads depth images and masks, rejects implausible ones, and takes out the object's points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import CameraError, InputError, PointCloudError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.models.quantities import Count, Positive
from feasigrasp.recordings.camera_file import read_camera


def camera_file_of(depth: str | Path) -> Path:
    """The ``camera.json`` beside a depth image, or one folder up.

    Raises:
        InputError: There is none.
    """
    folder = Path(depth).absolute().parent
    for place in (folder, folder.parent):
        if (place / "camera.json").is_file():
            return place / "camera.json"
    raise InputError(
        f"there is no camera.json beside {depth} or one folder up; give --intrinsics fx,fy,cx,cy"
    )


@checked(InputError)
def captured_points(
    depth: str | Path,
    camera: str | Path | None = None,
    mask: str | Path | None = None,
    box: Sequence[int] | None = None,
) -> Array:
    """The points of the object in a depth image, without pixels at its edge.

    Depth is a guess at an edge: stereo cameras smear there from one surface to the next.

    Args:
        depth: A 16-bit PNG.
        camera: A camera file, or ``fx,fy,cx,cy`` [px], see `read_camera`; without, the one that
            `camera_file_of` finds.
        mask: A picture that is not zero where the object is; without, all pixels are of it.
        box: First column and row, last ones [px]; without, the whole image counts.

    Returns:
        In the camera's frame, z forward, shape (n, 3) [m].

    Raises:
        InputError: A file is missing, or no such picture; or the depth is in another unit.
        CameraError: The camera is not that of the image, or the box is not in it.
        PointCloudError: No pixel of the object has a depth.
    """
    info = read_camera(camera or camera_file_of(depth))
    image = read_depth(depth, info.unit)
    check_unit(depth, image, info.unit)
    height, width = image.shape
    intrinsics = info.camera(width, height).intrinsics
    seen: Mask = np.asarray(image > 0.0)
    chosen = np.ones_like(seen) if mask is None else read_mask(mask, (height, width))
    if box is not None:
        chosen &= _box(box, height, width)
    if not (seen & chosen).any():
        raise PointCloudError(
            f"{depth} has no depth at any of the {np.count_nonzero(chosen)} pixels of the object; "
            "are mask and box those of this image, and is the object not too near to the camera?"
        )
    points = unproject(np.where(seen, image, np.inf), intrinsics)
    kept = seen & chosen & ~edge_pixels(points, seen, chosen, EDGE_JUMP)
    return np.asarray(points[:, kept].T)


def _box(box: Sequence[int], height: int, width: int) -> Mask:
    left, top, right, bottom = box
    if not (0 <= left < right < width and 0 <= top < bottom < height):
        raise CameraError(
            f"box {left} {top} {right} {bottom}: give left < right, top < bottom in an image of "
            f"{width} x {height} pixels"
        )
    inside = np.zeros((height, width), dtype=bool)
    inside[top : bottom + 1, left : right + 1] = True
    return inside


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
    # A median depth beyond these is a wrong unit [m]: a D405 measures from 0.07 m, and depth
    # cameras of robots to about 10 m (data sheets).
    plausible = 0.02, 20.0
    measured = depth[depth > 0.0]
    if measured.size == 0 or plausible[0] <= (middle := np.median(measured)) <= plausible[1]:
        return
    scale = 1e3 * unit  # as others give it: metres per unit, or units per metre
    meant = {"metres per unit": 1e3 * scale, "units per metre": 1e3 / scale}
    fits = [
        f"; if that is {what}, depth_scale is {value:g}"
        for what, value in meant.items()
        if plausible[0] <= middle * value / scale <= plausible[1]
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
