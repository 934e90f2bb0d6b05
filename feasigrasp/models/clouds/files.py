"""Reads point clouds from files and rejects implausible ones."""

import io
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import PointCloudError
from feasigrasp.inputs import read_arrays
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.checks import MAX_EXTENT, MIN_POINTS
from feasigrasp.models.quantities import POINTS

#: File formats that `read_cloud` reads.
SUFFIXES = (".ply", ".pcd", ".xyz", ".npy", ".npz")
#: NumPy's letters of the types of fields in ``.pcd`` files.
_PCD_KINDS = {"F": "f", "I": "i", "U": "u"}
#: Wider than this, a cloud of a graspable object is in millimetres [m]. Source: guessed.
_MILLIMETRES = 20.0


@checked(PointCloudError)
def read_cloud(filename: str | Path) -> Array:
    """Reads a point cloud.

    Args:
        filename: A ``.ply``, ``.pcd`` or ``.xyz`` file, or NumPy's ``.npy`` or ``.npz`` with an
            array (n, 3), or (h, w, 3) as organised clouds are; further columns are ignored. Of an
            ``.npz`` the only such array counts.

    Returns:
        Points in the file's own unit, shape (n, 3), without those that hold NaN or infinity, which
        is how sensors mark pixels without depth; nor those at exactly zero, which is how others do.
        A point that is repeated counts once: loaders of networks draw points with repetition.

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
            points = _read_pcd(path)
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
    kept = np.isfinite(points).all(axis=1) & points.any(axis=1)
    if not kept.any():
        raise PointCloudError(f"{path.name}: all points are zero or not finite; record it anew")
    points = points[kept]
    return points[np.sort(np.unique(points, axis=0, return_index=True)[1])]


def viewpoint_of(path: Path) -> list[float] | None:
    """Where the camera was, in the file's unit; None if the file does not say it.

    By the header of a ``.pcd``, or a line ``comment viewpoint x y z`` (or ``obj_info``) of a
    ``.ply``.
    """
    starts = {".pcd": rb"VIEWPOINT", ".ply": rb"(?:comment|obj_info)\s+viewpoint"}
    if (start := starts.get(path.suffix.lower())) is None:
        return None
    head = re.split(rb"\n(?:DATA |end_header)", path.read_bytes(), maxsplit=1)[0]
    found = re.search(rb"^" + start + rb"[:=\s]+(\S+)\s+(\S+)\s+(\S+)", head, re.I | re.M)
    try:
        p = [float(word) for word in found.groups()] if found else []
    except ValueError:
        return None
    return p if any(p) else None


def _read_pcd(path: Path) -> Array:
    """The fields x, y and z of all points of a file, shape (n, 3); NaN where it has NaN.

    Raises:
        PointCloudError: The header is no such header, or does not fit the size of the file.
        ValueError: The points are not of the kind that the header says.
    """
    head, found, data = path.read_bytes().partition(b"\nDATA ")
    kind, line_end, body = data.partition(b"\n")
    lines = (line.split() for line in head.decode("ascii").splitlines())
    entries = {line[0]: line[1:] for line in lines if line and not line[0].startswith("#")}
    if not (found and line_end and {"FIELDS", "SIZE", "TYPE", "POINTS"} <= set(entries)):
        raise PointCloudError(f"{path.name} has no whole header of a .pcd file")
    fields, sizes = entries["FIELDS"], [int(size) for size in entries["SIZE"]]
    counts = [int(count) for count in entries.get("COUNT", ["1"] * len(fields))]
    n = int(entries["POINTS"][0])
    if not (len(fields) == len(sizes) == len(counts) == len(entries["TYPE"]) and n >= 0):
        raise PointCloudError(f"{path.name}: the lines of its header contradict each other")
    width, height = (int(entries.get(name, ["1"])[0]) for name in ("WIDTH", "HEIGHT"))
    if "WIDTH" in entries and width * height != n:
        raise PointCloudError(f"{path.name} has {n} points, but {width} x {height}")
    if min(sizes) < 1 or min(counts) < 1 or max(sizes) > 8 or max(counts) > 4096:
        raise PointCloudError(f"{path.name}: fields of {sizes} bytes, {counts} times")
    if not {"x", "y", "z"} <= set(fields):
        raise PointCloudError(f"{path.name} has fields {' '.join(fields)}, and not x y z")
    sort, lengths = kind.strip().lower(), [s * c for s, c in zip(sizes, counts, strict=True)]
    least = {b"ascii": 2 * n * sum(counts), b"binary": n * sum(lengths), b"binary_compressed": 8}
    if sort not in least or (n and len(body) + 1 < least[sort]):
        raise PointCloudError(f"{path.name} is cut off: it holds fewer than its {n} points")
    axes, starts = [fields.index(axis) for axis in "xyz"], np.cumsum([0, *lengths])
    if n == 0:
        return np.zeros((0, 3))
    if sort == b"ascii":
        columns = [sum(counts[:i]) for i in axes]
        points = np.loadtxt(io.BytesIO(body), usecols=columns, max_rows=n, ndmin=2)
        if len(points) < n:
            raise PointCloudError(f"{path.name} is cut off: it holds fewer than its {n} points")
        return points
    if sort == b"binary_compressed":
        packed, size = (int.from_bytes(body[i : i + 4], "little") for i in (0, 4))
        if packed > len(body) - 8 or size != n * starts[-1]:
            raise PointCloudError(f"{path.name} is cut off: its compressed part does not fit")
        flat = np.frombuffer(_unpacked(body[8 : 8 + packed]), np.uint8, size)
        by_field = np.split(flat, n * starts[1:-1])
        table = np.concatenate([field.reshape(n, -1) for field in by_field], axis=1)
    else:
        table = np.frombuffer(body, np.uint8, n * starts[-1]).reshape(n, -1)
    row = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [f"<{_PCD_KINDS[entries['TYPE'][i]]}{sizes[i]}" for i in axes],
            "offsets": [int(starts[i]) for i in axes],
            "itemsize": int(starts[-1]),
        }
    )
    rows = table.view(row)[:, 0]
    return np.stack([rows[axis] for axis in "xyz"], axis=1).astype(float)


def _unpacked(packed: bytes) -> bytes:
    """What LZF made ``packed`` of: runs of bytes, and copies of what came before."""
    out, i = bytearray(), 0
    while i < len(packed):
        control, i = packed[i], i + 1
        if control < 32:
            out += packed[i : i + control + 1]
            i += control + 1
            continue
        length = control >> 5
        if length == 7:
            length, i = length + packed[i], i + 1
        back = ((control & 31) << 8) + packed[i] + 1
        i += 1
        period = out[len(out) - back :][: length + 2]
        out += (period * (length + 2))[: length + 2]
    return bytes(out)


@checked(PointCloudError)
def prepare_cloud(
    points: Annotated[ArrayLike, POINTS],
    *,
    scale: float = 1.0,
    crop: Sequence[float] | None = None,
    viewpoint: Sequence[float] | None = (0.0, 0.0, 0.0),
    scene: bool = False,
) -> Array:
    """Converts a cloud to meters and segments the object, or raises an error.

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
        box = np.asarray(crop, dtype=float)
        low, high = box.reshape(3, 2).T if box.shape == (6,) else (np.ones(3), np.zeros(3))
        if not (low < high).all():
            raise PointCloudError(f"--crop {list(crop)}: give xmin xmax ymin ymax zmin zmax")
        cloud = cloud[((cloud >= low) & (cloud <= high)).all(axis=1)]
    if len(cloud) < MIN_POINTS:
        inside = "" if crop is None else f" inside --crop {' '.join(f'{c:g}' for c in crop)}"
        raise PointCloudError(f"{len(cloud)} points{inside}; an object needs at least {MIN_POINTS}")
    _check_extent(cloud, _MILLIMETRES if scene else MAX_EXTENT)
    if viewpoint is not None:
        camera = np.asarray(viewpoint, dtype=float)
        if camera.shape != (3,) or not np.isfinite(camera).all():
            raise PointCloudError(f"--viewpoint {camera.tolist()}: give x y z in metres")
        if ((camera > cloud.min(axis=0)) & (camera < cloud.max(axis=0))).all():
            raise PointCloudError(
                f"the camera at {camera.tolist()} stands amid the points: this cloud is not in the "
                "camera's frame. Pass --viewpoint X Y Z, or --merged if it shows several sides"
            )
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
            "--on-table or --crop, in a depth image also with --mask or --box (or is it a cloud in "
            "centimetres: --scale 0.01)"
        )
    if extent < 0.005:
        raise PointCloudError(
            f"the cloud is {1e3 * extent:.2g} mm wide, too small to grasp; is its unit right? Pass "
            "--scale"
        )


def _only_cloud(path: Path) -> NDArray[np.generic]:
    arrays = read_arrays(path)
    # A camera matrix has the shape of a cloud, too, and colors have that of an organised one.
    clouds = {
        name: array
        for name, array in arrays.items()
        if _is_cloud(array) and len(array) > 4 and array.dtype != np.uint8
    }
    if not clouds and {"depth", "K"} <= set(arrays):
        raise PointCloudError(
            f"{path.name} holds a depth image and its camera, and no cloud; read it by "
            "captured_points"
        )
    if len(clouds) != 1:
        raise PointCloudError(
            f"{path.name} holds {len(clouds)} arrays that could be a cloud"
            f"{': ' if clouds else ''}{', '.join(clouds)}; save one (n, 3) array as .npy"
        )
    return next(iter(clouds.values()))


def _is_cloud(array: NDArray[np.generic]) -> bool:
    # Depth and color images have their pixels in rows, not three columns of coordinates.
    return array.dtype.kind in "fiu" and array.ndim in (2, 3) and 3 <= array.shape[-1] <= 7
