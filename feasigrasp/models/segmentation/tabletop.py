"""Dominant plane of a cloud, and the body on it: tabletop segmentation.

For clouds of real cameras, where neither arm nor cell nor an earlier image is known. The plane that
holds most points is the table; of what stands on it, the largest body is the object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.clouds.fusion import grouped_means, voxel_keys


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
    # Draws of three points in the search for tables; resolution [m].
    table_draws, table_resolution = 300, 0.005
    # What stands on it spreads less than this share of the table, and nearly all on one side.
    on_table, one_side = 0.7, 0.9
    # A table holds at least this share of the cloud, within so much of a plane [m].
    table_share, table_thickness = 0.4, 0.006
    # Smaller clouds are of one object, flat or not [m].
    table_extent = 0.25
    if float(np.ptp(points, axis=0).max()) < table_extent:
        return
    thin, _ = grouped_means(points, voxel_keys(points, table_resolution), np.ones(len(points)))
    plane = largest_plane(thin, table_thickness, table_draws)
    height = thin @ plane[:3] + plane[3]
    flat = np.abs(height) <= table_thickness
    share, rest = float(flat.mean()), height[~flat]
    if share < table_share or len(rest) == 0:
        return
    up = rest > 0.0
    if viewpoint is not None:
        standing = up == bool(viewpoint @ plane[:3] + plane[3] > 0.0)
    else:
        standing = up if up.mean() > 0.5 else ~up
    if standing.mean() < one_side:
        return
    across = [_width(thin[chosen], plane[:3]) for chosen in (~flat, flat)]
    if across[1] < table_extent or across[0] > on_table * across[1]:
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
    # Points that planes are compared by; the share of a plane is then known to 1 % (one sigma).
    some = rng.permutation(points)[:2500]
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


#: Points within so much of the plane are the table's [m]; what stands on it starts higher. Source:
#: guessed.
_THICKNESS, _STANDS = 0.005, 0.006
#: Resolution at which bodies are separated, and how near their parts are to each other [m]. Source:
#: guessed.
_RESOLUTION, _JOINED = 0.004, 0.02
#: Fewer points than this of the resolution are no object. Source: guessed.
_LEAST = 20


def object_on_table(points: ArrayLike, viewpoint: ArrayLike = (0.0, 0.0, 0.0)) -> Mask:
    """Mask of the points of a cloud on the object above the table.

    Args:
        points: Finite points of table, object and what else is in view, shape (n, 3) [m].
        viewpoint: Where the camera was, shape (3,) [m]; above the table.

    Returns:
        Shape (n,).

    Raises:
        PointCloudError: Nothing stands on the largest plane.
    """
    cloud = np.asarray(points, dtype=float)
    keys = voxel_keys(cloud, _RESOLUTION)
    thin, _ = grouped_means(cloud, keys, np.ones(len(cloud)))
    normal, offset = _plane(thin, viewpoint)
    standing = np.flatnonzero(thin @ normal + offset > _STANDS)
    if len(standing) < _LEAST:
        raise PointCloudError(
            "nothing stands on the largest plane of the cloud; is the object in it? For a cloud of "
            "the object alone leave --on-table out"
        )
    pairs = cKDTree(thin[standing]).query_pairs(_JOINED, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(standing),) * 2)
    _, body = connected_components(links, directed=False)
    largest = standing[body == np.argmax(np.bincount(body))]
    of_object = np.zeros(len(thin), dtype=bool)
    of_object[largest] = True
    _, voxel = np.unique(keys, return_inverse=True)  # in the order of grouped_means
    above = cloud @ normal + offset > _STANDS
    return np.asarray(of_object[voxel] & above)


def table_plane(points: ArrayLike, viewpoint: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """The plane that holds most points, e.g. of a table.

    Args:
        points: Finite points, shape (n, 3) [m].
        viewpoint: Where the camera was, shape (3,) [m].

    Returns:
        Its unit normal, towards the camera, and its offset: ``n . x + d`` is the height of x, (4,).

    Raises:
        PointCloudError: There are hardly any points.
    """
    cloud = np.asarray(points, dtype=float)
    keys = voxel_keys(cloud, _RESOLUTION)
    thin, _ = grouped_means(cloud, keys, np.ones(len(cloud)))
    if len(thin) < _LEAST:
        raise PointCloudError(f"a cloud of {len(thin)} voxels of 4 mm shows no table")
    normal, offset = _plane(thin, viewpoint)
    return np.append(normal, offset)


def _plane(thin: Array, viewpoint: ArrayLike) -> tuple[Array, float]:
    """Unit normal and offset of the plane with most points, the camera on its positive side."""
    # Draws of three points in the search for the plane.
    plane = largest_plane(thin, _THICKNESS, 1000)
    normal, offset = plane[:3], float(plane[3])
    sign = 1.0 if normal @ np.asarray(viewpoint, dtype=float) + offset > 0.0 else -1.0
    return sign * normal, sign * offset
