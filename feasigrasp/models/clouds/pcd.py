"""Files of the Point Cloud Library: ``.pcd`` of version 0.7, as text, binary or compressed."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array

#: NumPy's letters of the types of the format.
_KINDS = {"F": "f", "I": "i", "U": "u"}


def read_pcd(path: Path) -> Array:
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
            "formats": [f"<{_KINDS[entries['TYPE'][i]]}{sizes[i]}" for i in axes],
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
