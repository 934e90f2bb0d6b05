"""Tabletop segmentation: the body on the dominant plane of a cloud.

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
from feasigrasp.models.clouds.table import largest_plane

#: Points within so much of the plane are the table's [m]; what stands on it starts higher.
_THICKNESS, _STANDS = 0.005, 0.006
#: Resolution at which bodies are separated, and how near their parts are to each other [m].
_RESOLUTION, _JOINED = 0.004, 0.02
#: The plane is sought with so many draws of three points.
_DRAWS = 1000
#: Fewer points than this of the resolution are no object.
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
    plane = largest_plane(thin, _THICKNESS, _DRAWS)
    normal, offset = plane[:3], float(plane[3])
    sign = 1.0 if normal @ np.asarray(viewpoint, dtype=float) + offset > 0.0 else -1.0
    return sign * normal, sign * offset
