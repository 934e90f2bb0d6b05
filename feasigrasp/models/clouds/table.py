"""Detection of the dominant plane of a cloud, and of a table with an object on it."""

from __future__ import annotations

import numpy as np

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.fusion import grouped_means, voxel_keys

#: Smaller clouds are of one object, flat or not [m].
_TABLE_EXTENT = 0.25
#: A table holds at least this share of the cloud, within so much of a plane [m].
_TABLE_SHARE, _TABLE_THICKNESS = 0.4, 0.006
#: What stands on it spreads less than this share of the table, and nearly all on one side.
_ON_TABLE, _ONE_SIDE = 0.7, 0.9
#: Tables are sought with so many draws of three points; resolution [m].
_DRAWS, _RESOLUTION = 300, 0.005
#: Points that planes are compared by; the share of a plane is then known to 1 % (one sigma).
_COMPARED = 2500


def check_no_table(points: Array, viewpoint: Array | None) -> None:
    """Refuses a cloud that is mostly one plane with something on it.

    The plane is a table if the rest stands on its one side, that of the camera, and amid it. What
    lies behind a plane is the rest of a box, and what stands round it the wall of a tray.

    Args:
        points: The cloud, shape (n, 3) [m].
        viewpoint: Where the camera was, shape (3,) [m]; None for merged views.

    Raises:
        PointCloudError: It shows a table.
    """
    if float(np.ptp(points, axis=0).max()) < _TABLE_EXTENT:
        return
    thin, _ = grouped_means(points, voxel_keys(points, _RESOLUTION), np.ones(len(points)))
    plane = largest_plane(thin, _TABLE_THICKNESS, _DRAWS)
    height = thin @ plane[:3] + plane[3]
    flat = np.abs(height) <= _TABLE_THICKNESS
    share, rest = float(flat.mean()), height[~flat]
    if share < _TABLE_SHARE or len(rest) == 0:
        return
    up = rest > 0.0
    if viewpoint is not None:
        standing = up == bool(viewpoint @ plane[:3] + plane[3] > 0.0)
    else:
        standing = up if up.mean() > 0.5 else ~up
    if standing.mean() < _ONE_SIDE:
        return
    across = [_width(thin[chosen], plane[:3]) for chosen in (~flat, flat)]
    if across[1] < _TABLE_EXTENT or across[0] > _ON_TABLE * across[1]:
        return
    raise PointCloudError(
        f"{100.0 * share:.0f} % of the cloud is one plane, {across[1]:.2f} m wide, with something "
        "on it: a table. Segment the object first: cut it out with --on-table "
        "(object_on_table(...)) or --crop (prepare_cloud(crop=...)) above the plane, or keep the "
        "points of its mask"
    )


def largest_plane(points: Array, thickness: float, draws: int, seed: int = 0) -> Array:
    """The plane with the most points within ``thickness``, fitted to these by least squares.

    By random sample consensus (Fischler 1981).

    Args:
        points: Shape (n, 3), n > 0 [m].
        thickness: Largest distance of its points [m].
        draws: Planes through three random points that are tried.
        seed: Of the draws.

    Returns:
        Unit normal and offset: ``n . x + d`` is the signed distance of x [m], shape (4,).
    """
    rng = np.random.default_rng(seed)
    some = rng.permutation(points)[:_COMPARED]
    a, b, c = points[rng.integers(len(points), size=(3, draws))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.where(length > 0.0, length, 1.0)[:, None]
    offsets = -np.einsum("ni,ni->n", normals, a)
    count = (np.abs(some @ normals.T + offsets) <= thickness).sum(axis=0)
    best = int(np.argmax(np.where(length > 0.0, count, 0)))  # not of three points on a line
    near = points[np.abs(points @ normals[best] + offsets[best]) <= thickness]
    middle = near.mean(axis=0)
    normal = np.linalg.eigh((near - middle).T @ (near - middle))[1][:, 0]
    return np.append(normal, -normal @ middle)


def _width(points: Array, normal: Array) -> float:
    """Largest extent across a normal, but for stray points [m]."""
    along = points - np.outer(points @ normal, normal)
    low, high = np.percentile(along, [5.0, 95.0], axis=0)
    return float(np.max(high - low))
