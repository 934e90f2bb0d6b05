"""Requirements on clouds, removal of outliers, and which views are worth merging."""

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
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


@dataclass(frozen=True, eq=False)
class ViewRecord(Frozen):
    """The views of an object that is tracked in its own frame O.

    A view from nearly the same side adds no surface; what it still adds is an average over the
    noise, which a few views bring and more do not. And yet a side is looked at again after a while:
    what hid a part of it may be gone.

    Attributes:
        p_OC: Positions of the camera in O, shape (n, 3) [m].
        times: When it was there, shape (n,) [s].
    """

    p_OC: Array = field(default_factory=lambda: np.zeros((0, 3)))
    times: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        self._freeze(p_OC=np.array(self.p_OC, dtype=float), times=np.array(self.times, dtype=float))

    def extended(self, p_OC: ArrayLike, time: float) -> "ViewRecord":
        """With one more view."""
        return ViewRecord(np.vstack([self.p_OC, p_OC]), np.append(self.times, time))

    def turned(self, p_OC: ArrayLike) -> float:
        """Angle [rad] of a camera at p_OC (3,) to the nearest view's direction; pi without any."""
        return float(np.arccos(self._cosines(p_OC).max(initial=-1.0)))

    def adds_information(self, p_OC: ArrayLike, time: float, n_views: int, revisit: float) -> bool:
        """Whether a view from p_OC (3,) [m] at a time [s] is worth taking.

        Of one side ``n_views`` suffice, unless it was not looked at for ``revisit`` [s].
        """
        distances = np.linalg.norm(self.p_OC, axis=1)
        # A view that is nearer by more than this factor sees finer.
        near = distances < 1.3 * np.linalg.norm(p_OC)
        # Views from closer directions than this show the same side (cosine).
        similar = (self._cosines(p_OC) > np.cos(np.deg2rad(10.0))) & near
        enough = int(np.count_nonzero(similar)) >= n_views
        return not enough or time - float(self.times[similar].max()) >= revisit - 1e-9

    def _cosines(self, p_OC: ArrayLike) -> Array:
        """Cosines of the angles between a camera at p_OC (3,) and every view, seen from O."""
        camera = np.asarray(p_OC, dtype=float)
        lengths = np.linalg.norm(self.p_OC, axis=1) * np.linalg.norm(camera)
        return np.clip(self.p_OC @ camera / np.maximum(lengths, 1e-12), -1.0, 1.0)


class ViewFault(StrEnum):
    """Why a view could not be used."""

    UNKNOWN_POSE = "the pose of object or camera is unknown"
    NOT_FINITE = "no finite point"
    TOO_WIDE = "too wide for an object"
    MOSTLY_OUTLIERS = "mostly outliers"
    BACKGROUND = "nothing but background"
    ONE_DEPTH = "the same depth everywhere"
    NO_SURFACE = "points on a spot or line"
    NO_FIELD = "no field fits"
    OUTVOTED = "later views agree on another place"


def of_one_depth(points: Array, X_WC: Array) -> bool:
    """Whether all points (n, 3) in W have the same depth, which no camera measures of an object.

    Not even of a plane: it would be at right angles to the camera's axis within a thousandth.
    """
    depth = (points - X_WC[:3, 3]) @ X_WC[:3, 2]
    # Depths that differ less all over an object are not measured: a camera's noise is larger [m].
    return len(points) > 0 and float(np.ptp(depth)) < 1e-4


def usable_points(
    points: Array, p_OC: ArrayLike, min_points: int, known: Array
) -> tuple[Array, ViewFault | None, str]:
    """The points of a view without its outliers, if they can be those of an object.

    Finite points (n, 3), the camera's position (3,), and points (k, 3) of earlier views are in O
    [m]. With a mask that is too large, or beside the object, what lies far behind it is in the view
    as well, and nothing else when the hand is so close that the camera does not see the object.
    Fewer than ``min_points`` show nothing. With the points that are left, (m, 3), comes what is
    wrong with the view, None if nothing is, and by what figures.
    """
    # Largest extent of an object beyond the observed surface [m]; points that do show that the mask
    # is wrong, unless all of them do and could be the object: then it is elsewhere.
    beyond, like_the_object = 0.1, 1.5
    bad = outliers(points, p_OC)
    kept = points[~bad]
    # A view of which less remains without its outliers shows no object.
    if len(kept) < max(min_points, 0.5 * len(bad)):
        return kept, ViewFault.MOSTLY_OUTLIERS, f"{bad.sum()} of {len(bad)} points"
    if spread_across(kept) < MIN_SPREAD:
        return kept, ViewFault.NO_SURFACE, f"{len(kept)} points"
    unlike = False
    if len(known) > 0:
        lower, upper = known.min(axis=0), known.max(axis=0)
        near = ((kept >= lower - beyond) & (kept <= upper + beyond)).all(axis=1)
        size, most = np.linalg.norm(np.ptp(kept, axis=0)), np.linalg.norm(upper - lower)
        if np.count_nonzero(near) >= min_points:
            kept = kept[near]
        else:
            unlike = bool(size > like_the_object * most)
    extent = float(np.ptp(kept, axis=0).max())
    if extent > MAX_EXTENT:
        return kept, ViewFault.TOO_WIDE, f"{extent:.3g} m, more than {MAX_EXTENT:g} m"
    if unlike:
        return kept, ViewFault.BACKGROUND, f"{size:.3g} m of it, the object has {most:.3g} m"
    return kept, None, ""
