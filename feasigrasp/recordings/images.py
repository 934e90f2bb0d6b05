"""Reads depth images and masks, rejects implausible ones, and takes out the object's points."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from feasigrasp.errors import CameraError, InputError, PointCloudError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels, smeared_pixels
from feasigrasp.models.compiled import compiled
from feasigrasp.models.quantities import Count, Positive
from feasigrasp.recordings.camera_file import find_camera, read_camera


def camera_file_of(depth: str | Path) -> Path:
    """The camera file beside a depth image, or one folder up; an InputError if there is none."""
    folder = Path(depth).absolute().parent
    found = find_camera(folder) or find_camera(folder.parent)
    if found is None:
        mend = "give --intrinsics fx,fy,cx,cy"
        raise InputError(f"there is no camera.json beside {depth} or one folder up; {mend}")
    return found


@checked(InputError)
def captured_points(
    depth: str | Path,
    camera: str | Path | None = None,
    mask: str | Path | None = None,
    box: Sequence[int] | None = None,
    label: Count | None = None,
) -> Array:
    """The points of the object in a depth image, without pixels at its edge.

    Depth is a guess at an edge: stereo cameras smear there from one surface to the next.

    Args:
        depth: A depth image, see `read_depth`. An ``.npz`` may hold the camera's matrix, as ``K``,
            and a mask or labels, as ``segmap`` or ``mask``, too.
        camera: A camera file, or ``fx,fy,cx,cy`` [px], see `read_camera`; without, the one that
            `camera_file_of` finds.
        mask: A picture that is not zero where the object is; without, all pixels are of it.
        box: First column and row, last ones [px]; without, the whole image counts.
        label: The object's value in the mask, if that shows several.

    Returns:
        In the camera's frame, z forward, shape (n, 3) [m].

    Raises:
        InputError: A file is missing, or no such picture; or the depth is in another unit.
        CameraError: The camera is not that of the image, or the box is not in it.
        PointCloudError: No pixel of the object has a depth.
    """
    arrays = read_arrays(depth) if Path(depth).suffix == ".npz" else {}
    inside = camera is None and "K" in arrays
    info = read_camera(depth if inside else camera or camera_file_of(depth))
    image = read_depth(depth, info.unit)
    check_unit(depth, image, info.unit)
    height, width = image.shape
    of_image = info.camera(width, height)
    seen: Mask = np.asarray(image > 0.0)
    given = next((arrays[name] for name in ("segmap", "mask") if name in arrays), None)
    pixels = given if mask is None else _pixels(Path(mask))
    chosen = np.ones_like(seen)
    if pixels is not None:
        chosen = mask_of(pixels, image.shape, label, mask or depth)
        if not chosen.any():
            shown = ", ".join(map(str, np.unique(pixels)[:8].tolist()))
            other = "--mask" if label is None else "--label"
            raise InputError(f"{mask or depth} shows {shown} and no object; give another {other}")
    elif label is not None:
        raise InputError(f"--label {label} is a value in a mask; give --mask, or leave it out")
    if box is not None:
        check_box(box, image.shape)
        left, top, right, bottom = box
        within: Mask = np.zeros_like(seen)
        within[top : bottom + 1, left : right + 1] = True
        chosen &= within
    if not (seen & chosen).any():
        raise PointCloudError(
            f"{depth} has no depth at any of the {np.count_nonzero(chosen)} pixels of the object; "
            "are mask and box those of this image, and is the object not too near to the camera?"
        )
    points = unproject(np.where(seen, image, np.inf), of_image.intrinsics)
    kept = seen & chosen & ~edge_pixels(points, seen, chosen, EDGE_JUMP)
    kept &= ~smeared_pixels(image, of_image)
    return np.asarray(points[:, kept].T)


def check_box(box: Sequence[int] | None, shape: tuple[int, ...]) -> None:
    """Raises a CameraError for a box (first column and row, last ones) that is not in an image.

    The image has a shape (height, width); None is no box.
    """
    if box is None:
        return
    (left, top, right, bottom), (height, width) = box, shape
    if not (0 <= left <= right < width and 0 <= top <= bottom < height):
        raise CameraError(
            f"--box {left} {top} {right} {bottom}: give LEFT <= RIGHT < {width} and "
            f"TOP <= BOTTOM < {height}, from 0 on"
        )


#: Ends of the names of depth images.
DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".npz", ".exr")


@checked(InputError)
def read_depth(file: str | Path, unit: Positive = 1e-3) -> Array:
    """Reads a depth image.

    Args:
        file: A picture of one channel of `DEPTH_SUFFIXES`, of floating-point numbers or of whole
            ones with more than 8 bits; an ``.npz`` has it as ``depth``.
        unit: Metres per unit of whole numbers; others are in metres.

    Returns:
        Depths along the optical axis, 0 where nothing was measured, shape (height, width) [m].

    Raises:
        InputError: It is no picture of one channel, or has 8 bits.
    """
    pixels = _pixels(Path(file))
    if pixels.dtype.kind == "f":
        depth = np.where(np.isfinite(pixels) & (pixels > 0.0), pixels, 0.0).astype(float)
        check_unit(file, depth, None)
        return depth
    if pixels.dtype.kind not in "iu" or pixels.dtype.itemsize < 2:
        raise InputError(
            f"{file} has {8 * pixels.dtype.itemsize}-bit pixels ({pixels.dtype.name}), which hold "
            "no measured depth; save the raw depth as a 16-bit PNG"
        )
    return unit * pixels.astype(float)


@checked(InputError)
def read_mask(file: str | Path, shape: tuple[Count, Count], label: Count | None = None) -> Mask:
    """Reads which pixels show the object: those other than zero, or those of a label.

    Args:
        file: A picture of one channel.
        shape: Height and width of the depth image that it goes with.
        label: The object's value, where the picture shows several; without, there may be one only.

    Raises:
        InputError: It is no picture, has another size, or several labels of which none is given.
    """
    return mask_of(_pixels(Path(file)), shape, label, file)


def mask_of(
    pixels: NDArray[Any], shape: tuple[int, int], label: int | None, source: str | Path
) -> Mask:
    """The object's pixels in a mask or label image, see `read_mask`."""
    check_size(source, pixels.shape, shape)
    if label is not None:
        return np.asarray(pixels == label)
    shown = pixels[pixels != 0]
    labels, counts = np.unique(shown, return_counts=True)
    # A mask whose rim is blurred has nearly all of its pixels in one value; labels have not.
    if len(labels) > 1 and counts.max() < 0.9 * len(shown):
        listed = ", ".join(f"{each:g}" for each in labels[:8])
        raise InputError(f"{source} shows several objects, {listed}; give --label")
    return np.asarray(pixels != 0)


@checked(InputError)
def read_color(
    file: str | Path, shape: tuple[Count, Count], factor: Count = 1
) -> NDArray[np.uint8]:
    """Reads a color image of the pixels of a depth image of a shape (height, width).

    A JPEG is decoded at the size that is asked for, where it can be: ``factor`` is that of
    `decimated`, the result of shape (height // factor, width // factor, 3).

    Raises:
        InputError: It is no picture, or has another size.
    """
    small = shape[1] // factor, shape[0] // factor
    with suppress(OSError, ValueError, SyntaxError), Image.open(file) as image:
        whole = (image.mode, image.size) == ("RGB", shape[::-1])
        if whole and image.draft("RGB", small) and image.size == small:
            return np.asarray(image)
    pixels = _pixels(Path(file), colors=True)
    check_size(file, pixels.shape[:2], shape)
    colors = np.repeat(pixels[..., None], 3, axis=2) if pixels.ndim == 2 else pixels[..., :3]
    return np.ascontiguousarray(picked(colors, factor), dtype=np.uint8)


def decimated(depth: Array, factor: int) -> Array:
    """A depth image (h, w) [m] with fewer pixels: medians of what was measured in squares.

    A side of a square has ``factor`` pixels. Of two medians it is the lower one; 0 stands for what
    was not measured, here as there, shape (h // factor, w // factor).
    """
    if factor == 1:
        return depth
    small = np.empty([n // factor for n in depth.shape])
    _medians(np.ascontiguousarray(depth, dtype=float), factor, small)
    return small


@compiled(nogil=True)
def _medians(depth, factor, small):
    """Writes the medians of squares of pixels, see `decimated`."""
    ordered = np.empty(factor * factor)
    for row in range(small.shape[0]):
        for column in range(small.shape[1]):
            count = 0
            for i in range(factor):
                for j in range(factor):
                    z = depth[row * factor + i, column * factor + j]
                    if z > 0.0:
                        k = count
                        while k > 0 and ordered[k - 1] > z:
                            ordered[k] = ordered[k - 1]
                            k -= 1
                        ordered[k] = z
                        count += 1
            small[row, column] = ordered[(count - 1) // 2] if count > 0 else 0.0


def picked(image: NDArray[Any], factor: int) -> NDArray[Any]:
    """The middle pixels of the squares of `decimated`, of a mask or color image."""
    h, w = (n // factor for n in image.shape[:2])
    return image[factor // 2 :: factor, factor // 2 :: factor][:h, :w]


def check_size(file: str | Path, shape: tuple[int, ...], expected: tuple[int, int]) -> None:
    """Raises an InputError for a picture of another size (height, width) than the depth image's."""
    if shape != expected:
        raise InputError(
            f"{file} has {shape[1]} x {shape[0]} pixels, but the depth image "
            f"{expected[1]} x {expected[0]}"
        )


def check_unit(file: str | Path, depth: Array, unit: float | None) -> None:
    """Raises an InputError for depths (height, width) [m] that were read with a wrong unit [m].

    Their median is nothing that a depth camera measures. The unit of floating-point numbers, which
    are in metres, is None.
    """
    # Medians [m]: a D405 measures from 0.07 m, and depth cameras of robots to about 10 m (data
    # sheets).
    low, high = 0.02, 20.0
    measured = depth[depth > 0.0]
    if measured.size == 0 or low <= (middle := np.median(measured)) <= high:
        return
    if unit is None:
        raise InputError(
            f"{file}: its median depth is {middle:.3g}, and floating-point images are in metres; "
            "scale it, or save whole numbers with their depth_scale in camera.json"
        )
    scale = 1e3 * unit  # as others give it: metres per unit, or units per metre
    meant = {"metres per unit": 1e3 * scale, "units per metre": 1e3 / scale}
    fits = [
        f"; if that is {what}, depth_scale is {value:g}"
        for what, value in meant.items()
        if low <= middle * value / scale <= high
    ]
    raise InputError(
        f"{file}: its median depth is {middle:.2g} m with depth_scale {scale:g} [mm per unit], "
        f"which no depth camera measures{fits[0] if fits else '; mend depth_scale'}"
    )


def _pixels(file: Path, *, colors: bool = False) -> NDArray[Any]:
    """A picture of one channel, shape (h, w), or of colors, (h, w, 3)."""
    if not file.is_file():
        raise InputError(f"there is no file {file}")
    if file.suffix == ".exr":
        pixels = _exr(file)
    elif file.suffix in (".npy", ".npz"):
        found = read_arrays(file)
        pixels = next((found[n] for n in ("depth", "arr_0") if n in found), np.zeros(0)).squeeze()
    else:
        try:
            with Image.open(file) as image:
                pixels = np.asarray(image)
        except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
            raise InputError(f"{file} is no whole picture ({error})") from error
    if pixels.ndim < 2:
        raise InputError(f"{file} holds no picture; give an array of shape (height, width)")
    if pixels.ndim != 2 and not colors:
        raise InputError(f"{file} has {pixels.shape[-1]} channels; a depth image or mask has one")
    return pixels


def _exr(file: Path) -> NDArray[Any]:
    """The first channel of an OpenEXR picture, shape (h, w)."""
    try:
        import OpenEXR
    except ImportError as error:
        raise InputError(f"{file} is read by OpenEXR ({error}); pip install OpenEXR") from error
    try:
        channels = OpenEXR.File(str(file), separate_channels=True).channels()
    except RuntimeError as error:
        raise InputError(f"{file} is no whole picture ({error})") from error
    return np.asarray(next(iter(channels.values())).pixels)


def holds_depth(file: Path) -> bool:
    """Whether an ``.npz`` holds a depth image with its camera, and not a cloud."""
    return file.suffix == ".npz" and file.is_file() and {"depth", "K"} <= set(read_arrays(file))
