"""Reads folders of depth images in the layouts of TUM RGB-D, BOP and others.

::

    depth/           16-bit PNG or TIFF, or float TIFF, EXR or NumPy [m]
    camera.json      or another camera file, see `feasigrasp.recordings.camera_file`
    depth.txt        optional, "time file" line by line (TUM); else the files' names are times if
                     they are numbers with a point, as TUM's are, or the images come at a rate
    color/ or rgb/   optional, of the same names or, with rgb.txt, times
    mask/ or masks/  optional, of the same names: other than zero where the object is. Also BOP's
                     mask_visib/ with names IMAGE_OBJECT, pictures with a label per object, and
                     mask.png for the first image
    groundtruth.txt  optional, "time tx ty tz qx qy qz qw" of the camera (TUM); else it stands still

Large images are decimated when they are read: tracking needs no more than 430 pixels in a row.
"""

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from feasigrasp.errors import InputError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.geometry import se3
from feasigrasp.models.quantities import UNKNOWN_POSES, ArrayOf, Count, Positive, Whole
from feasigrasp.recordings.camera_file import find_camera, read_camera
from feasigrasp.recordings.images import (
    DEPTH_SUFFIXES,
    check_size,
    check_unit,
    decimated,
    picked,
    read_color,
    read_depth,
    read_mask,
)


@dataclass(frozen=True, eq=False)
class DepthFolder(Frozen):
    """A recorded sequence; images are read when they are asked for.

    Attributes:
        camera: The camera of the images as they are handed out.
        files: Depth images in the order of their times.
        times: When they were taken, shape (n,) [s].
        unit: Metres per unit of images of whole numbers.
        X_WC: Poses of the camera, shape (n, 4, 4).
        masks: Masks of the object, by the names of the depth images; empty if there are none.
        label: The object's value in them, if they show several.
        colors: Color images in the same way.
        size: Height and width of the files, if other than the camera's [px].
        decimation: How many of their pixels one is, along each axis.
        notes: What is in the folder and not used.
    """

    camera: Camera
    files: list[Path]
    times: Annotated[Array, ArrayOf(("n",), "s")]
    unit: Positive
    X_WC: Annotated[Array, UNKNOWN_POSES]
    masks: dict[str, Path] = field(default_factory=dict)
    label: Count | None = None
    colors: dict[str, Path] = field(default_factory=dict)
    size: tuple[Count, Count] | None = None
    decimation: Count = 1
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, InputError)

    @checked(InputError)
    def depth(self, k: Whole) -> Array:
        """Depth image k, 0 where nothing was measured, shape (height, width) [m].

        Raises:
            InputError: It cannot be read, or has another size than the first.
        """
        depth = read_depth(self.files[k], self.unit)
        check_size(self.files[k], depth.shape, self.file_shape)
        return decimated(depth, self.decimation)

    @checked(InputError)
    def mask(self, k: Whole) -> Mask | None:
        """The object's pixels in image k, if there is a mask of it, shape (height, width).

        Raises:
            InputError: It cannot be read, or has another size than the depth.
        """
        file = self.masks.get(self.files[k].stem)
        mask = None if file is None else read_mask(file, self.file_shape, self.label)
        return None if mask is None else picked(mask, self.decimation)

    @checked(InputError)
    def color(self, k: Whole) -> NDArray[np.uint8] | None:
        """Color image k, if there is one, shape (height, width, 3).

        Raises:
            InputError: It cannot be read, or has another size than the depth.
        """
        file = self.colors.get(self.files[k].stem)
        return None if file is None else read_color(file, self.file_shape, self.decimation)

    @property
    def file_shape(self) -> tuple[int, int]:
        """Height and width of the files [px]."""
        return self.size or (self.camera.height, self.camera.width)


@checked(InputError)
def read_depth_folder(
    folder: str | Path, rate: Positive = 30.0, label: Count | None = None
) -> DepthFolder:
    """Reads a folder of depth images, see above.

    Args:
        folder: The folder.
        rate: Images per second, where nothing says when they were taken.
        label: The object's value in masks that show several, or its number in their names.

    Raises:
        InputError: Something is missing or cannot be read, or the depths are in another unit.
        CameraError: The camera is not that of the images.
    """
    root = Path(folder)
    if not root.is_dir():
        raise InputError(f"there is no folder {root}")
    files, times = _stamped(root, rate)
    info = read_camera(find_camera(root) or root / "camera.json")
    for file in files:
        depth = read_depth(file, info.unit)
        if depth.any():
            break
    check_unit(file, depth, info.unit)
    size = height, width = depth.shape
    factor = decimation(width)
    camera, X_WC = info.camera(width, height).decimated(factor), _camera_poses(root, times)
    masks, label, notes = _masks(root, files, label)
    colors, more = _colors(root, files, times)
    notes += more
    return DepthFolder(
        camera, files, times, info.unit, X_WC, masks, label, colors, size, factor, notes
    )


def decimation(width: int) -> int:
    """How many of the pixels of images of a width [px] are one, along each axis, for tracking."""
    # Pixels in a row that suffice: half the widest image of a RealSense at 30 Hz.
    return -(-width // 430)


def _masks(
    root: Path, files: list[Path], label: int | None
) -> tuple[dict[str, Path], int | None, tuple[str, ...]]:
    """Masks by the names of depth images, the object's value in them, and notes on others."""
    # Of BOP's two folders that of the visible parts.
    names = ("mask_visib", "mask", "masks", "segmentation", "seg", "labels", "label")
    folder = next((root / name for name in names if any(_pictures(root / name))), None)
    if folder is None:
        only = root / "mask.png"
        if label is not None and not only.is_file():
            raise InputError(f"--label {label}: {root} has no masks; leave it out")
        return ({files[0].stem: only} if only.is_file() else {}), label, ()
    found = {file.stem: file for file in _pictures(folder)}
    stems = {file.stem for file in files}
    if not stems & set(found):  # BOP: IMAGE_OBJECT
        parts = {stem: stem.rpartition("_") for stem in found}
        numbers = sorted({end for image, _, end in parts.values() if image in stems})
        chosen = [n for n in numbers if label is None or n.isdigit() and int(n) == label]
        if len(chosen) != 1:
            several = f"objects {', '.join(numbers[:8])}; give --label"
            what = several if numbers else "no depth image"
            raise InputError(f"the names of the masks in {folder} are of {what}")
        found = {parts[s][0]: file for s, file in found.items() if parts[s][2] == chosen[0]}
        label = None
    used, notes = _of_images(found, stems, f"masks in {folder}")
    return used, label, notes


def _colors(root: Path, files: list[Path], times: Array) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Color images by the names of depth images, and notes on others."""
    listed = root / "rgb.txt"
    if listed.is_file():
        stamps, names = zip(*_stamped_list(listed), strict=True)
        nearest, near = _nearest(np.array(stamps), times)
        pairs = zip(files, nearest, near, strict=True)
        return {file.stem: names[at] for file, at, is_near in pairs if is_near}, ()
    found = {file.stem: file for name in ("color", "rgb") for file in _pictures(root / name)}
    return _of_images(found, {file.stem for file in files}, "color images")


def _of_images(
    found: dict[str, Path], stems: set[str], what: str
) -> tuple[dict[str, Path], tuple[str, ...]]:
    """Those that have the name of a depth image, and a note if there are others."""
    used = {stem: file for stem, file in found.items() if stem in stems}
    note = f"{len(found) - len(used)} {what} have the name of no depth image, and are not used"
    return used, (note,) if len(used) < len(found) else ()


def _pictures(folder: Path) -> list[Path]:
    """The pictures of a folder, in the order of their names."""
    suffixes = (*DEPTH_SUFFIXES, ".jpg", ".jpeg")
    return sorted(f for f in folder.glob("*") if f.suffix.lower() in suffixes)


def _stamped(root: Path, rate: float) -> tuple[list[Path], Array]:
    """The depth images and their times, in the order of these."""
    list_file = root / "depth.txt"
    if list_file.is_file():
        pairs = _stamped_list(list_file)
    else:
        files = _pictures(root / "depth")
        pairs = [(k / rate, file) for k, file in enumerate(files)]
        with suppress(ValueError):  # else the names are no times
            if all("." in file.stem for file in files):
                pairs = [(float(file.stem), file) for file in files]
    if not pairs:
        raise InputError(f"there are no depth images {root / 'depth' / '*.png'}")
    pairs.sort()
    times = np.array([time for time, _ in pairs])
    # No camera takes so few images [s]; stamps of ROS are in nanoseconds.
    if len(times) > 1 and (gap := float(np.median(np.diff(times)))) > 60.0:
        raise InputError(f"{root}: images are {gap:g} s apart by their times; give seconds")
    return [file for _, file in pairs], times


def _stamped_list(file: Path) -> list[tuple[float, Path]]:
    """Times and files of a list of TUM RGB-D."""
    rows = [row.split() for row in _lines(file)]
    try:
        return [(float(row[0]), file.parent / row[1]) for row in rows]
    except (ValueError, IndexError):
        raise InputError(f'{file}: give lines "time file", as TUM RGB-D does') from None


def _camera_poses(root: Path, times: Array) -> Array:
    """X_WC (n, 4, 4) at some times; NaN where there is none near by, and if it stands still I."""
    file = root / "groundtruth.txt"
    if not file.is_file():
        return np.tile(np.eye(4), (len(times), 1, 1))
    try:
        rows = np.array([row.split() for row in _lines(file)], dtype=float).reshape(-1, 8)
        R = Rotation.from_quat(rows[:, 4:]).as_matrix()
    except ValueError:
        raise InputError(f'{file}: give lines "time tx ty tz qx qy qz qw"') from None
    if not len(rows):
        raise InputError(f"{file} has no pose")
    poses = np.full((len(times), 4, 4), np.nan)
    nearest, near = _nearest(rows[:, 0], times)
    poses[near] = se3.make_pose(R, rows[:, 1:4])[nearest[near]]
    if not near.any():
        raise InputError(f"{file} has no pose at the time of any image")
    return poses


def _nearest(stamps: Array, times: Array) -> tuple[Indices, Mask]:
    """Which of some stamps is nearest to each time, and whether it is of the same image."""
    nearest = np.abs(stamps[:, None] - times).argmin(axis=0)
    # What is no farther from an image in time is of it [s].
    return nearest, np.abs(stamps[nearest] - times) <= 0.02


def _lines(file: Path) -> list[str]:
    """The lines of a text file that say something."""
    try:
        lines = file.read_text().splitlines()
    except (OSError, ValueError) as error:
        raise InputError(f"{file} cannot be read: {error}") from error
    return [line for line in lines if line.strip() and not line.startswith("#")]
