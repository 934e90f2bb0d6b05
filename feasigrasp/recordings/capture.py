"""One depth image with its camera and mask, as points of the object."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from feasigrasp.errors import CameraError, InputError, PointCloudError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.camera import unproject
from feasigrasp.models.clouds.edges import EDGE_JUMP, edge_pixels
from feasigrasp.recordings.camera_file import read_camera
from feasigrasp.recordings.images import check_unit, read_depth, read_mask


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
