"""Point clouds of real sensors: reading them, and finding out that they are not what they seem."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import PointCloudError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import MAX_EXTENT, MIN_POINTS
from feasigrasp.models.clouds.pcd import read_pcd

#: File formats that `read_cloud` knows.
SUFFIXES = (".ply", ".pcd", ".xyz", ".npy", ".npz")
#: Wider than this, a cloud of a graspable object is in millimetres [m].
_MILLIMETRES = 20.0


def read_cloud(filename: str | Path) -> Array:
    """Reads a point cloud.

    Args:
        filename: A ``.ply``, ``.pcd`` or ``.xyz`` file, or NumPy's ``.npy`` or ``.npz`` with an
            array (n, 3), or (h, w, 3) as organised clouds are; further columns are ignored. Of an
            ``.npz`` the only such array counts.

    Returns:
        Points in the file's own unit, shape (n, 3), without those that hold NaN or infinity, which
        is how sensors mark pixels without depth; nor those at exactly zero, which is how others do.

    Raises:
        PointCloudError: There is no such file, or no cloud in it.
    """
    path = Path(filename)
    if not path.is_file():
        raise PointCloudError(f"there is no file {path}")
    if path.suffix.lower() not in SUFFIXES:
        raise PointCloudError(f"{path.name}: give a file of {', '.join(SUFFIXES)}")
    try:
        if path.suffix.lower() == ".npz":
            points = _only_cloud(path)
        elif path.suffix.lower() == ".npy":
            points = np.asarray(np.load(path, allow_pickle=False))
        elif path.suffix.lower() == ".xyz":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what an empty file is, is said below
                points = np.loadtxt(path, ndmin=2)
        elif path.suffix.lower() == ".ply":
            import trimesh  # a slow import that arrays do not need

            loaded: Any = trimesh.load(path, file_type="ply")
            points = np.asarray(loaded.vertices)
        else:
            points = read_pcd(path)
    except PointCloudError:
        raise
    except Exception as error:  # the readers raise whatever they stumble over
        raise PointCloudError(f"{path.name} cannot be read: {error}") from error
    if points.size == 0:
        raise PointCloudError(f"{path.name} holds no points, or is no valid {path.suffix} file")
    if not _is_cloud(points):
        raise PointCloudError(
            f"{path.name} holds an array of {points.dtype} with shape {points.shape}; "
            "give numbers of shape (n, 3)"
        )
    points = points[..., :3].reshape(-1, 3).astype(float)
    return points[np.isfinite(points).all(axis=1) & points.any(axis=1)]


def prepare_cloud(
    points: ArrayLike,
    *,
    scale: float = 1.0,
    crop: Sequence[float] | None = None,
    viewpoint: Sequence[float] | None = (0.0, 0.0, 0.0),
    scene: bool = False,
) -> Array:
    """Brings a cloud to metres and cuts the object out, or says what is wrong with it.

    Args:
        points: Shape (n, 3), in any unit.
        scale: Factor from that unit to metres.
        crop: Box to keep: least and greatest x, then y, then z [m].
        viewpoint: Where the camera was [m], in the cloud's frame; None if the cloud merges views
            from several sides.
        scene: Whether it shows more than the object, which is cut out afterwards: then it may be
            wider than an object.

    Returns:
        Points of the object, shape (n, 3) [m].

    Raises:
        PointCloudError: Wrong unit, wrong frame, background in the cloud, or nothing left of it;
            the message names the option of ``feasigrasp perceive`` that mends it.
    """
    if not (np.isfinite(scale) and scale > 0.0):
        raise PointCloudError(f"--scale {scale}: give a positive factor from its unit to metres")
    cloud = scale * np.asarray(points, dtype=float)
    if crop is not None:
        low, high = np.asarray(crop, dtype=float).reshape(3, 2).T
        if not (low < high).all():
            raise PointCloudError(f"--crop {list(crop)}: give xmin xmax ymin ymax zmin zmax")
        cloud = cloud[((cloud >= low) & (cloud <= high)).all(axis=1)]
    if len(cloud) < MIN_POINTS:
        inside = "" if crop is None else f" inside --crop {' '.join(f'{c:g}' for c in crop)}"
        raise PointCloudError(f"{len(cloud)} points{inside}; an object needs at least {MIN_POINTS}")
    _check_extent(cloud, _MILLIMETRES if scene else MAX_EXTENT)
    if viewpoint is not None:
        _check_viewpoint(cloud, np.asarray(viewpoint, dtype=float))
    return cloud


def _check_extent(cloud: Array, most: float) -> None:
    extent = float(np.ptp(cloud, axis=0).max())
    if extent > _MILLIMETRES:
        raise PointCloudError(
            f"the cloud is {extent:.0f} wide: it is in millimetres, not metres; pass --scale 0.001"
        )
    if extent > most:
        raise PointCloudError(
            f"the cloud is {extent:.1f} m wide: it holds more than one object; cut that out with "
            "--crop (or is it in centimetres: --scale 0.01)"
        )
    if extent < 0.005:
        raise PointCloudError(
            f"the cloud is {1e3 * extent:.2g} mm wide, too small to grasp; is its unit right? Pass "
            "--scale"
        )


def _check_viewpoint(cloud: Array, viewpoint: Array) -> None:
    if viewpoint.shape != (3,) or not np.isfinite(viewpoint).all():
        raise PointCloudError(f"--viewpoint {viewpoint.tolist()}: give x y z in metres")
    if ((viewpoint > cloud.min(axis=0)) & (viewpoint < cloud.max(axis=0))).all():
        raise PointCloudError(
            f"the camera at {viewpoint.tolist()} stands amid the points: this cloud is not in the "
            "camera's frame. Pass --viewpoint X Y Z, or --merged if it shows several sides"
        )


def _only_cloud(path: Path) -> NDArray[np.generic]:
    clouds = {name: array for name, array in read_arrays(path).items() if _is_cloud(array)}
    # A camera matrix has the shape of a cloud, too.
    clouds = {n: a for n, a in clouds.items() if len(a) > 4} or clouds
    if len(clouds) != 1:
        raise PointCloudError(
            f"{path.name} holds {len(clouds)} arrays that could be a cloud"
            f"{': ' if clouds else ''}{', '.join(clouds)}; save one (n, 3) array as .npy"
        )
    return next(iter(clouds.values()))


def _is_cloud(array: NDArray[np.generic]) -> bool:
    # Depth and colour images have their pixels in rows, not three columns of coordinates.
    return array.dtype.kind in "fiu" and array.ndim in (2, 3) and 3 <= array.shape[-1] <= 7
