"""Dominant plane of a cloud, and the body on it: tabletop segmentation.

For clouds of real cameras, where neither arm nor cell nor an earlier image is known.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.clouds.checks import smeared
from feasigrasp.models.clouds.fusion import grouped_means, voxel_keys
from feasigrasp.models.segmentation.components import LARGEST


def check_no_table(points: Array, viewpoint: Array | None) -> None:
    """Refuses a cloud that is mostly one plane with something on it.

    The plane is a table if the rest stands on its one side, that of the camera, and amid it. What
    lies behind a plane is the rest of a box, and what stands round it the wall of a tray. For
    merged views there is no viewpoint.

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
        "(tabletop(...)) or --crop (prepare_cloud(crop=...)) above the plane, or keep the "
        "points of its mask"
    )


def largest_plane(points: Array, thickness: float, draws: int) -> Array:
    """The plane with the most points (n, 3) within ``thickness`` [m], fitted to these.

    By random sample consensus (Fischler 1981) of as many draws of three points, and least squares.
    Unit normal and offset, shape (4,): ``n . x + d`` is the signed distance of x [m].
    """
    rng = np.random.default_rng(0)
    # Points that planes are compared by; the share of a plane is then known to 1 % (one sigma).
    some = rng.permutation(points)[:2500]
    normals, offsets = _drawn_planes(points, draws, rng)
    count = (np.abs(some @ normals.T + offsets) <= thickness).sum(axis=0)
    best = int(np.argmax(np.where(normals.any(axis=1), count, 0)))
    return _fitted_plane(points[np.abs(points @ normals[best] + offsets[best]) <= thickness])


def _drawn_planes(points: Array, draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Normals (draws, 3) and offsets of planes through three points each; zero if on a line."""
    a, b, c = points[rng.integers(len(points), size=(3, draws))]
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1)
    normals /= np.where(length > 0.0, length, 1.0)[:, None]
    return normals, -np.einsum("ni,ni->n", normals, a)


def _fitted_plane(points: Array) -> Array:
    """The plane of least squares through points (n, 3): unit normal and offset, shape (4,)."""
    middle = points.mean(axis=0)
    normal = np.linalg.eigh((points - middle).T @ (points - middle))[1][:, 0]
    return np.append(normal, -normal @ middle)


def _width(points: Array, normal: Array) -> float:
    """Largest extent across a normal, but for stray points [m]."""
    along = points - np.outer(points @ normal, normal)
    low, high = np.percentile(along, [5.0, 95.0], axis=0)
    return float(np.max(high - low))


#: Points within so much of the plane are the table's [m]; what stands on it starts higher. Source:
#: guessed.
_THICKNESS, _STANDS = 0.005, 0.006
#: Fewer points than this of the resolution are no object. Source: guessed.
_LEAST = 20


def table_plane(points: ArrayLike, viewpoint: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """The plane of the table, as `tabletop` finds it; the largest one if nothing stands on any.

    Its unit normal, towards the camera, and its offset: ``n . x + d`` is the height of x, (4,).

    Raises:
        PointCloudError: There are hardly any points.
    """
    thin, _ = _thinned(np.asarray(points, dtype=float))
    if len(thin) < _LEAST:
        raise PointCloudError(f"a cloud of {len(thin)} voxels of 4 mm shows no table")
    planes = _planes(thin, np.asarray(viewpoint, dtype=float))
    found = _nearest_standing(thin, planes, np.asarray(viewpoint, dtype=float))
    return planes[0] if found is None else found[1]


def tabletop(points: ArrayLike, viewpoint: ArrayLike = (0.0, 0.0, 0.0)) -> tuple[Mask, Array]:
    """The object on a table: of the large planes, the table is the one under what is nearest.

    A plane counts if a body of a graspable size stands on it; of several bodies on the table, the
    largest is the object.

    Args:
        points: Finite points of table, object and what else is in view, shape (n, 3) [m].
        viewpoint: Where the camera was, shape (3,) [m]; above the table.

    Returns:
        Mask of the object's points, shape (n,); and the plane, see `table_plane`.

    Raises:
        PointCloudError: Nothing stands on any large plane.
    """
    cloud, camera = np.asarray(points, dtype=float), np.asarray(viewpoint, dtype=float)
    surface = ~smeared(cloud, camera)
    thin, voxel = _thinned(cloud[surface])
    found = _nearest_standing(thin, _planes(thin, camera), camera)
    if found is None:
        raise PointCloudError(
            "nothing of a graspable size stands on a large plane of the cloud; is the object in "
            f"it, and higher than {1e3 * _STANDS:.0f} mm? For a cloud of the object alone leave "
            "--on-table out"
        )
    body, plane = found
    of_object = np.zeros(len(thin), dtype=bool)
    of_object[body] = True
    mask = cloud @ plane[:3] + plane[3] > _STANDS
    mask[surface] &= of_object[voxel]
    return np.asarray(mask & surface), plane


def _thinned(cloud: Array) -> tuple[Array, Indices]:
    """Means of the voxels of a cloud, and the voxel of each point."""
    keys = voxel_keys(cloud, 0.004)  # the resolution at which bodies are separated [m]
    thin, _ = grouped_means(cloud, keys, np.ones(len(cloud)))
    return thin, np.unique(keys, return_inverse=True)[1]  # in the order of grouped_means


def _planes(thin: Array, viewpoint: Array) -> list[Array]:
    """The large planes of a cloud, shape (4,) each, the camera above each; the largest first."""
    # Planes that are looked for, at most; the share of the cloud that one holds at least.
    most, share = 5, 0.04
    planes: list[Array] = []
    left = thin
    while len(planes) < most and len(left) >= max(_LEAST, share * len(thin)):
        # Draws of three points in the search for the plane.
        plane = largest_plane(left, _THICKNESS, 1000)
        on = np.abs(left @ plane[:3] + plane[3]) <= _THICKNESS
        if planes and np.count_nonzero(on) < share * len(thin):
            break
        planes.append(plane if plane[:3] @ viewpoint + plane[3] > 0.0 else -plane)
        left = left[~on]
    return planes


def _nearest_standing(
    thin: Array, planes: list[Array], viewpoint: Array
) -> tuple[Indices, Array] | None:
    """The largest body on that plane which has the nearest one, and the plane.

    Of several planes that have the same body nearest, it is the one that it stands lowest on.
    """
    # A body that shows less than this share of the largest one's voxels is a piece of one.
    piece = 0.2
    on_planes = [(body, plane) for plane in planes for body in [_standing(thin, plane, viewpoint)]]
    sized = [(body, plane) for body, plane in on_planes if len(body) >= _LEAST]
    if not sized:
        return None
    least = piece * max(len(body) for body, _ in sized)

    def near_and_low(each: tuple[Indices, Array]) -> tuple[float, float]:
        points, plane = thin[each[0]], each[1]
        near = float(np.linalg.norm(points - viewpoint, axis=1).min())
        return round(near, 3), float((points @ plane[:3] + plane[3]).min())

    return min(((b, p) for b, p in sized if len(b) >= least), key=near_and_low)


def _standing(thin: Array, plane: Array, viewpoint: Array) -> Indices:
    """The largest body of a graspable size on a plane, and amid it; empty if there is none."""
    # A body that is seen from the side begins this near to the plane that it stands on [m]. From
    # above its foot is hidden: nothing of a box is seen but its top. Parts of one are so near [m].
    foot, joined = 0.02, 0.02
    height = thin @ plane[:3] + plane[3]
    above = np.flatnonzero(height > _STANDS)
    if len(above) < _LEAST:
        return above[:0]
    pairs = cKDTree(thin[above]).query_pairs(joined, output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(above),) * 2)
    _, number = connected_components(links, directed=False)
    for which in np.argsort(-np.bincount(number), kind="stable")[:10]:
        body = above[number == which]
        extent = np.linalg.norm(np.ptp(thin[body], axis=0))
        sight = viewpoint - thin[body].mean(axis=0)
        beside = np.linalg.norm(np.cross(plane[:3], sight)) / np.linalg.norm(sight)
        if extent <= LARGEST and height[body].min() < foot + LARGEST * (1.0 - beside):
            return body
    return above[:0]


def support_plane(
    around: Array, body: Array, p_WC: Array, tolerance: float, guesses: Sequence[Array] = ()
) -> Array | None:
    """The plane that a body stands on: that with most points round it which has it above.

    By points about the body (n, 3), those of the body (m, 3), m > 0, the camera's position (3,)
    above the plane, and the largest distance of points of the plane [m]; it may be one of some
    guesses (4,), e.g. that of the last image.

    Returns:
        Its unit normal and offset, see `table_plane`; None if the body stands on nothing.
    """
    # Draws of three points; points that are compared; share of these that the plane holds.
    draws, compared, share = 60, 800, 0.15
    # The body's lowest points are no higher than this above the plane it stands on [m], and of its
    # points at least this share is above, and less than the second in the plane: else it is a face.
    standing, above, on_it = 0.03, 0.95, 0.8
    # A plane is one that was guessed at this cosine between both normals; how far the body may be
    # off it then [m].
    alike, uncertain = 0.97, 0.03
    if len(around) < _LEAST:
        return None
    some = around[:: -(-len(around) // compared)]
    drawn = np.column_stack(_drawn_planes(some, draws, np.random.default_rng(0)))
    planes = np.vstack([*guesses, drawn])
    planes *= np.where(planes[:, :3] @ p_WC + planes[:, 3] > 0.0, 1.0, -1.0)[:, None]
    height = body[:: -(-len(body) // 200)] @ planes[:, :3].T + planes[:, 3]
    off = np.full(len(planes), tolerance)
    for guess in guesses:  # where the body is expected is uncertain, how it stands is not
        off[planes[:, :3] @ guess[:3] > alike] += uncertain
    under = (height > -off).mean(axis=0) >= above
    under &= (np.abs(height) <= tolerance).mean(axis=0) < on_it
    under &= np.percentile(height, 5.0, axis=0) < standing + off
    on = np.abs(some @ planes[:, :3].T + planes[:, 3]) <= tolerance
    count = np.where(under, on.sum(axis=0), 0)
    for best in np.argsort(-count, kind="stable")[:5]:
        near = some[on[:, best]]
        if count[best] < share * len(some) or not _all_round(near, np.median(body, axis=0)):
            continue
        plane = _fitted_plane(near)
        return plane * np.sign(plane[:3] @ planes[best, :3])
    return None


def _all_round(points: Array, p: Array) -> bool:
    """Whether points (n, 3) of a plane lie round the foot of a point p (3,) above it."""
    across = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][:2]
    x, y = across @ (points - p).T
    angle = np.sort(np.arctan2(y, x))
    return bool(np.max(np.diff(angle, append=angle[0] + 2.0 * np.pi)) < np.pi)
