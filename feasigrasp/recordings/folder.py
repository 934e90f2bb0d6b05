"""Reads folders of depth images in the layouts of TUM RGB-D and BOP.

::

    depth/*.png      16-bit depth images
    camera.json      fx, fy, cx, cy [px] and depth_scale, see `feasigrasp.recordings.camera_file`
    depth.txt        optional, "time file" line by line (TUM); else the files' names are times if
                     they are numbers with a point, as TUM's are, or the images come at a rate
    mask/*.png       optional, of the same names: other than zero where the object is
    groundtruth.txt  optional, "time tx ty tz qx qy qz qw" of the camera (TUM); else it stands still
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.spatial.transform import Rotation

from feasigrasp.errors import InputError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import UNKNOWN_POSES, ArrayOf, Positive, Whole
from feasigrasp.recordings.camera_file import read_camera
from feasigrasp.recordings.images import check_size, check_unit, read_depth, read_mask


@dataclass(frozen=True, eq=False)
class DepthFolder(Frozen):
    """A recorded sequence; images are read when they are asked for.

    Attributes:
        camera: The camera.
        files: Depth images in the order of their times.
        times: When they were taken, shape (n,) [s].
        unit: Metres per unit of the images.
        X_WC: Poses of the camera, shape (n, 4, 4).
        masks: Masks of the object, by the names of the depth images; empty if there are none.
    """

    camera: Camera
    files: list[Path]
    times: Annotated[Array, ArrayOf(("n",), "s")]
    unit: Positive
    X_WC: Annotated[Array, UNKNOWN_POSES]
    masks: dict[str, Path] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks what it is made of."""
        check_fields(self, InputError)

    @checked(InputError)
    def depth(self, k: Whole) -> Array:
        """Depth image k, 0 where nothing was measured, shape (height, width) [m].

        Raises:
            InputError: It cannot be read, or has another size than the first.
        """
        depth = read_depth(self.files[k], self.unit)
        check_size(self.files[k], depth.shape, (self.camera.height, self.camera.width))
        return depth

    @checked(InputError)
    def mask(self, k: Whole) -> Mask | None:
        """The object's pixels in image k, if there is a mask of it, shape (height, width).

        Raises:
            InputError: It cannot be read, or has another size than the depth.
        """
        file = self.masks.get(self.files[k].stem)
        shape = self.camera.height, self.camera.width
        return None if file is None else read_mask(file, shape)


@checked(InputError)
def read_depth_folder(folder: str | Path, rate: Positive = 30.0) -> DepthFolder:
    """Reads a folder of depth images, see above.

    Args:
        folder: The folder.
        rate: Images per second, where nothing says when they were taken.

    Raises:
        InputError: Something is missing or cannot be read, or the depths are in another unit.
        CameraError: The camera is not that of the images.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"there is no folder {root}")
    files, times = _stamped(root, rate)
    info = read_camera(root / "camera.json")
    for file in files:
        depth = read_depth(file, info.unit)
        if depth.any():
            break
    check_unit(file, depth, info.unit)
    height, width = depth.shape
    camera = info.camera(width, height)
    masks = {file.stem: file for file in sorted((root / "mask").glob("*.png"))}
    return DepthFolder(camera, files, times, info.unit, _camera_poses(root, times), masks)


def _stamped(root: Path, rate: float) -> tuple[list[Path], Array]:
    """The depth images and their times, in the order of these."""
    list_file = root / "depth.txt"
    if list_file.is_file():
        rows = [row.split() for row in _lines(list_file)]
        try:
            pairs = [(float(row[0]), root / row[1]) for row in rows]
        except (ValueError, IndexError):
            raise InputError(f'{list_file}: give lines "time file", as TUM RGB-D does') from None
    else:
        files = sorted((root / "depth").glob("*.png"))
        named = all("." in file.stem and _is_number(file.stem) for file in files)
        pairs = [(float(file.stem) if named else k / rate, file) for k, file in enumerate(files)]
    if not pairs:
        raise InputError(f"there are no depth images {root / 'depth' / '*.png'}")
    pairs.sort()
    return [file for _, file in pairs], np.array([time for time, _ in pairs])


def _camera_poses(root: Path, times: Array) -> Array:
    """X_WC (n, 4, 4) at some times; NaN where there is none near by, and if it stands still I."""
    # A pose of the camera is that of an image that was taken no farther from it in time [s].
    same_time = 0.02
    file = root / "groundtruth.txt"
    if not file.is_file():
        return np.tile(np.eye(4), (len(times), 1, 1))
    try:
        rows = np.array([row.split() for row in _lines(file)], dtype=float).reshape(-1, 8)
        R = Rotation.from_quat(rows[:, 4:]).as_matrix()
    except ValueError:
        raise InputError(f'{file}: give lines "time tx ty tz qx qy qz qw"') from None
    poses = np.full((len(times), 4, 4), np.nan)
    for k, time in enumerate(times):
        at = int(np.argmin(np.abs(rows[:, 0] - time)))
        if abs(rows[at, 0] - time) <= same_time:
            poses[k] = se3.make_pose(R[at], rows[at, 1:4])
    if not np.isfinite(poses).any():
        raise InputError(f"{file} has no pose within {same_time} s of any image")
    return poses


def _lines(file: Path) -> list[str]:
    """The lines of a text file that say something."""
    try:
        lines = file.read_text().splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: {error}") from error
    return [line for line in lines if line.strip() and not line.startswith("#")]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
