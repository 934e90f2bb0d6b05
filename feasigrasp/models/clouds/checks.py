"""Requirements on a point cloud before a field is fitted to it, and removal of outliers."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.clouds.camera import looking_along, projected, stereo_deviation

# Removal of outliers, flying pixels and reflections from a cloud.
#
# A camera's points lie on a surface, about as close together as its pixels are. What floats before
# or behind it has no neighbours so near, or few of its kind. "So near" is a multiple of the median
# over the cloud, which a fifth of bad points hardly moves. (Open3D's statistical outlier removal
# takes mean and standard deviation, which the bad points move to where they pass themselves.)
#
# How strict the limit is depends on the cloud: one without points far off has few close by, and
# where a surface is seen at a grazing angle its points are sparse too. Where the limit is strict,
# such a surface is visible in the image: there its points are as dense as others, and their depths
# continue those of their neighbours.


def outliers(points: Array, p_OC: ArrayLike | None = None) -> Mask:
    """Mask (n,) of outliers among finite points (n, 3) of one object [m]; none of very few points.

    The camera is at p_OC (3,) in the same frame; None for merged views.
    """
    # If more points than this share are far off, those are dropped that are beyond this multiple of
    # it.
    contaminated, near_factor = 0.02, 2.5
    # A point is judged by the distance to this neighbour, the nearest being the first. It is far
    # off beyond this multiple of the median of that distance.
    neighbour, far = 3, 5.0
    # Neighbours that a point hangs together with, at most.
    links = 8
    n = len(points)
    if n <= links:
        return np.zeros(n, dtype=bool)
    apart, near = cKDTree(points).query(points, k=links + 1)
    apart /= max(float(np.median(apart[:, neighbour])), 1e-12)
    relative = apart[:, neighbour]
    keep = relative <= far
    if np.mean(~keep) > contaminated:
        keep = relative <= near_factor
        sparse = np.flatnonzero(~keep)
        if p_OC is not None:
            keep[sparse] = _continue_the_picture(points, np.asarray(p_OC, dtype=float), sparse)
    # A point that is dropped is no bridge.
    link = keep[:, None] & keep[near] & (apart <= far)
    return ~_of_the_object(points, near, link, keep)


def least_smear(depth: Array, pitch: ArrayLike, noise: float) -> Array:
    """Difference of depth to both neighbours from which on pixels are between two surfaces [m].

    Of depths of any shape [m], the width of their pixels in the plane z = 1, of that shape or a
    number, and the noise `Camera.depth_noise` [1/m].
    """
    # A stereo camera matches nothing at this angle of incidence and more (tan 78 degrees), and
    # smears from one surface to the next; standard deviations of a depth that are noise.
    steep, sigmas = 4.6, 1.7
    return np.maximum(steep * np.asarray(pitch) * depth, sigmas * noise * depth**2)


def smeared(points: Array, p_OC: Array) -> Mask:
    """Mask of points between two surfaces, where a view smears from one to the next, shape (n,).

    As `edges.smeared_pixels`, for clouds without an order: of its neighbours in the picture one is
    too much nearer, and another one on the other side too much farther; the pitch of the pixels is
    estimated. The points (n, 3) are finite, and of one view from p_OC (3,) [m].
    """
    # Neighbours in the picture: of a grid of pixels the fourth nearest is one pitch away; share of
    # their differences of depth that a ramp explains, which two surfaces in one place are not.
    neighbours, pitch_of, explained = 8, 4, 0.9
    if len(points) <= neighbours:
        return np.zeros(len(points), dtype=bool)
    at, depth = projected(points, p_OC, looking_along(points.mean(axis=0) - p_OC))
    apart, near = cKDTree(at).query(at, k=neighbours + 1)
    pitch = float(np.median(apart[:, pitch_of]))
    noise = stereo_deviation(1.0 / max(pitch, 1e-6))
    least = least_smear(depth, np.maximum(apart[:, pitch_of], pitch), noise)
    beside = depth[near[:, : pitch_of + 1]]
    both = np.minimum(beside.max(axis=1) - depth, depth - beside.min(axis=1))
    chosen = np.flatnonzero(both > least)
    off = at[near[chosen, 1:]] - at[chosen, None]
    deeper = depth[near[chosen, 1:]] - depth[chosen, None]
    ramp = np.einsum("nkj,nk->nj", np.linalg.pinv(off).transpose(0, 2, 1), deeper)
    fitted = np.einsum("nkj,nj->nk", off, ramp)
    mask = np.zeros(len(points), dtype=bool)
    mask[chosen] = np.square(fitted).sum(axis=1) > explained * np.square(deeper).sum(axis=1)
    return mask


def _continue_the_picture(points: Array, p_OC: Array, chosen: Indices) -> Mask:
    """Which of some points have neighbours in the picture that their depth continues."""
    # Neighbours in the picture, and the multiples of their usual distance and of the spread of
    # their depths within which a point continues them.
    count_beside, most_apart, most_deeper = 12, 2.0, 3.0
    at, depth = projected(points, p_OC, looking_along(points.mean(axis=0) - p_OC))
    tree = cKDTree(at)
    k = min(count_beside + 1, len(points))
    usual = float(np.median(tree.query(tree.data[:: -(-len(points) // 200)], k=k)[0][:, -1]))
    apart, near = tree.query(tree.data[chosen], k=k)
    beside = depth[near[:, 1:]]
    expected = np.median(beside, axis=1)
    spread = np.median(np.abs(beside - expected[:, None]), axis=1)
    # Depths spread by so much at least [m].
    continues = np.abs(depth[chosen] - expected) <= most_deeper * np.maximum(spread, 1e-3)
    return np.asarray(continues & (apart[:, -1] <= most_apart * usual))


def _of_the_object(points: Array, near: Indices, link: Mask, keep: Mask) -> Mask:
    """Which kept points hang together, by links (n, k), in groups that the object can consist of.

    The largest group is of the object. What lies behind its rim, for example, when the mask is too
    large, hangs together as well, but far from it.
    """
    # Fewer points than this that hang together are no surface, and more than this distance from the
    # largest group they are of something else [m].
    min_group, elsewhere = 8, 0.05
    n = len(near)
    ends = np.concatenate([[0], np.cumsum(np.count_nonzero(link, axis=1))])
    graph = csr_matrix((np.ones(ends[-1]), near[link], ends), shape=(n, n))
    _, group = connected_components(graph, directed=False)
    sizes = np.bincount(group, weights=keep)
    belongs = sizes >= min_group
    largest = int(np.argmax(sizes))
    tree = cKDTree(points[keep & (group == largest)])
    for other in np.flatnonzero(belongs):
        if other != largest:
            distance, _ = tree.query(points[keep & (group == other)])
            belongs[other] = distance.min() <= elsewhere
    return np.asarray(keep & belongs[group])


#: Fewer points than this describe no surface. Source: guessed.
MIN_POINTS = 8
#: Larger clouds [m] are not one graspable object; most often they are in millimetres. Source:
#: reasoned: twice what the arm reaches.
MAX_EXTENT = 2.0
#: Points that spread less than this (standard deviation) in two directions are a spot or line [m].
#: Source: guessed.
MIN_SPREAD = 2.5e-4


def spread_across(cloud: Array) -> float:
    """Standard deviation of points (n, 3), n > 1, along their second principal direction [m]."""
    second = np.linalg.eigvalsh(np.cov(cloud, rowvar=False))[1]
    return float(np.sqrt(max(second, 0.0)))


def checked_cloud(points: ArrayLike) -> Array:
    """A copy of a cloud (n, 3) as float64; raises PointCloudError for an invalid one."""
    cloud = np.array(points, dtype=float, order="C")
    bad = int((~np.isfinite(cloud).all(axis=1)).sum())
    if bad:
        raise PointCloudError(
            f"{bad} of {len(cloud)} points hold NaN or infinity (invalid depth); drop them first"
        )
    if len(cloud) < MIN_POINTS:
        raise PointCloudError(
            f"{len(cloud)} points; a distance field needs at least {MIN_POINTS}. "
            "Is the object in view and the segmentation mask right?"
        )
    extent = float(np.ptp(cloud, axis=0).max())
    if extent > MAX_EXTENT:
        raise PointCloudError(
            f"the cloud is {extent:.3g} m wide, more than {MAX_EXTENT:g} m: is it in millimetres "
            "(multiply by 0.001), or does it hold the background too?"
        )
    spread = spread_across(cloud)
    if spread < MIN_SPREAD:
        raise PointCloudError(
            f"the points lie on one spot or line (extent {extent:.3g} m, spread across "
            f"{spread:.2g} m); a surface in metres is needed"
        )
    return cloud


def check_fit(length_scale: float, surface_offset: float | None, max_points: int) -> None:
    """Refuses parameters of the fit, positive ones, that are out of range, by name."""
    if surface_offset is not None and not surface_offset < length_scale:
        raise PointCloudError(
            f"surface_offset = {surface_offset}; give a length between 0 and length_scale "
            f"({length_scale:g} m), or None for the paper's field"
        )
    if max_points < MIN_POINTS:
        raise PointCloudError(f"max_points = {max_points}; give at least {MIN_POINTS}")


def directions_to_camera(cloud: Array, viewpoint: ArrayLike) -> Array:
    """Directions from the points to their cameras, (n, 3), given as such or as a position (3,)."""
    view = np.array(viewpoint, dtype=float)
    if view.shape == (3,):
        return view - cloud
    if view.shape == cloud.shape:
        return view
    raise PointCloudError(
        f"viewpoint has shape {view.shape}; give the camera position (3,) or one direction to the "
        f"camera per point {cloud.shape}"
    )
