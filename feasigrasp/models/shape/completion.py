"""Shape completion: merged views to a distance field with its variance.

The observed side of an object says little about its back, but where the camera looked past the
object it cannot be: beside the silhouette, nodes of the Gaussian process hold the value of free
space, which closes the surface behind. Surface that still ends up in free space is not handed out,
and the variance counts the observations alone: what free space shaped is as uncertain as what
nothing shaped.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from scipy.ndimage import binary_erosion
from scipy.spatial import Delaunay, cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.choices import parse_word
from feasigrasp.models.clouds.checks import check_fit, checked_cloud
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.view_image import ViewImage, free_distance, rim_points
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.quantities import POINTS, ArrayOf, Count, Positive, Whole
from feasigrasp.models.shape.gpdf import Gpdf, fit_field
from feasigrasp.models.shape.hidden_side import BackSurface, HiddenSide, load_hidden_side
from feasigrasp.models.shape.node_sums import cross_covariance
from feasigrasp.plugins import load_plugin, plugins


def hidden_nodes(
    field: Gpdf, images: Sequence[ViewImage], observed: Array, network: HiddenSide, count: int
) -> tuple[Array, Array]:
    """Points where the hidden surface probably is, on the far sides of all pictures.

    `hidden_side` estimates where the object ends behind each. Other pictures contradict that where
    they look through the place, or see a surface in front of it that is not the far one.

    The field is the estimate without the network; observed points (n, 3) [m] and one picture or
    more are in its frame.

    Returns:
        At most ``count`` points (k, 3) [m], and their expected errors along the line of sight (k,).
    """
    backs = network.back_surfaces(images, field)
    parts = [_of_picture(image, back) for image, back in zip(images, backs, strict=True)]
    points, deviation = (np.concatenate(part) for part in zip(*parts, strict=True))
    # Nodes closer to an observed point than this add nothing to it [m], nor do those closer than
    # this multiple of their expected error. Where several pictures look round the object, they more
    # often see such places themselves than that these are the far side of something thin. Source:
    # guessed.
    clearance, doubt = (10e-3, 1.5) if len(images) > 1 else (3e-3, 1.0)
    # Nodes deeper in the free space of a picture than this are impossible [m].
    kept = free_distance(images, points) < 2e-3
    for image, back in zip(images, backs, strict=True):
        kept &= ~_inside(image, back, points)
    points, deviation = points[kept], deviation[kept]
    kept = cKDTree(observed).query(points)[0] > np.maximum(clearance, doubt * deviation)
    points, deviation = points[kept], deviation[kept]
    if len(points) == 0:
        return points, deviation
    chosen = farthest_points(points, min(count, len(points)))
    return points[chosen], deviation[chosen]


def _of_picture(image: ViewImage, back: BackSurface) -> tuple[Array, Array]:
    """Points that are not measured of the pixels whose four neighbours show the object too.

    They are the far ones, and the near ones without a depth; with their deviations.
    """
    inner = binary_erosion(image.mask)
    near = inner & ~image.measured
    rows, columns = np.nonzero(np.stack([inner, near]))[1:]
    depth = np.concatenate([back.depth[inner], image.depth[near]])
    deviation = np.concatenate([back.deviation[inner], image.deviation[near]])
    return image.unproject((rows, columns), depth), deviation


def _inside(image: ViewImage, back: BackSurface, points: Array) -> Mask:
    """Which points (n, 3) a picture puts inside the object, by more than its sides may err."""
    row, column, z, within = image.project(points)
    at = row, column
    before = z < back.depth[at] - np.maximum(2.0 * back.deviation[at], 3e-3)
    behind = z > image.depth[at] + np.maximum(2.0 * image.deviation[at], 3e-3)
    inside: Mask = within & image.mask[at] & before & behind
    return inside


#: Values at this distance beside some of the points separate inside from outside [m]. Source:
#: guessed.
SURFACE_OFFSET = 2e-3
#: Points of the field that the hidden side is guessed from, which needs no detail. Source: guessed.
ROUGH_POINTS = 320


#: The field of this package.
DEFAULT = "default"


def field_names() -> list[str]:
    """Valid values of ``perception.preset``, plugins included."""
    return [DEFAULT, *plugins("fields")]


@dataclass(frozen=True, eq=False, kw_only=True)
class CompletedField(Gpdf):
    """A distance field with a mask of observed nodes and a map of free space.

    Attributes:
        cloud: The observed points, shape (c, 3) [m].
        cloud_normals: Their outward unit normals, as smoothed, shape (c, 3).
        images: The views whose free space counts.
        observed: Number of nodes, the first ones, that rest on observed points.
    """

    cloud: Annotated[Array, ArrayOf(("c", 3), "m")]
    cloud_normals: Annotated[Array, ArrayOf(("c", 3))]
    images: tuple[ViewImage, ...]
    observed: Whole
    has_free_space: ClassVar[bool] = True

    @checked(PointCloudError)
    def variance(self, x: Annotated[ArrayLike, POINTS]) -> Array:
        """Predictive variance of the occupancy at x (m, 3) given the observed nodes, (m,).

        Small near observed points, growing towards 1 away from them. Nodes in free space do not
        count: they say that there is nothing, not what there is. Behind observed surface it grows
        faster: the far side of a thin wall is near the observed surface, and still unobserved.
        """
        nodes = np.ascontiguousarray(self.nodes[:, : self.observed])
        x = self._withdrawn(np.asarray(x))
        cross = cross_covariance(nodes, self.length_scale, self.center, x)
        # The leading block of a Cholesky factor is the factor of the leading block.
        solved, _ = lapack.dtrtrs(self._observed_factor, cross.T, lower=1, overwrite_b=1)
        return np.maximum(1.0 - np.einsum("ji,ji->j", solved.T, solved.T), 0.0)

    def seen(self) -> tuple[Array, Array]:
        """Observed points (c, 3) [m] and outward normals there."""
        return self.cloud, self.cloud_normals

    @checked(PointCloudError)
    def possible(self, x: Annotated[Array, POINTS]) -> Mask:
        """Mask of points (m, 3) outside observed free space and not under the table, (m,)."""
        # Completed surface deeper in free space than this is dropped [m], unless an observed point
        # is this near [m]: then the view's edge is wrong, not the surface.
        carved, observed = 3e-3, 4e-3
        free = free_distance(self.images, x) > carved
        near = self._tree.query(x[free], distance_upper_bound=observed)[0]  # inf if none is
        free[free] = near > observed
        if self.table is not None:
            # Surface this far under the plane is not the object's [m].
            free |= x @ self.table[:3] + self.table[3] < -1e-3
        return ~free

    def _withdrawn(self, x: Array) -> Array:
        """Points (m, 3), those behind the nearest observed surface moved farther behind it."""
        nearest = self._tree.query(x)[1]
        normals = self.cloud_normals[nearest]
        behind = np.einsum("ij,ij->i", normals, self.cloud[nearest] - x)
        # Distance behind observed surface counts so much more for the variance.
        return x - 2.0 * np.maximum(behind, 0.0)[:, None] * normals

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.cloud)

    @cached_property
    def _observed_factor(self) -> Array:
        return np.asfortranarray(self.cholesky[: self.observed, : self.observed])


@checked(PointCloudError)
def complete_shape(
    cloud: FusedCloud,
    *,
    preset: str = DEFAULT,
    length_scale: Positive = 0.3,
    noise_variance: Positive | None = None,
    max_points: Count = 512,
    learnt: bool = True,
    table: Annotated[ArrayLike, ArrayOf((4,))] | None = None,
) -> Gpdf:
    """Fits the distance field to the merged views of an object.

    Args:
        cloud: The views, smoothed (``FusedCloud.smooth``) for the default preset.
        preset: One of `field_names`.
        length_scale: l of the kernel [m].
        noise_variance: s2 of the occupancy observations; by default 0.001, for smoothed views.
        max_points: Surface points that the field is fitted to, by farthest-point selection.
        learnt: Whether nodes are put where a network expects the hidden side (default preset only).
        table: The plane that the object stands on, see `Gpdf.table`: it closes the shape from below
            (default preset only).

    Returns:
        The field in the frame of the cloud, by default a `CompletedField`.

    Raises:
        PointCloudError: If there are too few points, or a parameter is out of range.
    """
    if parse_word(field_names(), preset, "preset", PointCloudError) != DEFAULT:
        fit: Callable[..., Gpdf] = load_plugin("fields", preset)
        options = {"length_scale": length_scale, "noise_variance": noise_variance}
        return fit(cloud, max_points=max_points, **options)
    if not cloud.smooth:
        raise PointCloudError(
            "the cloud is not smoothed; merge its views into FusedCloud.empty(..., smooth=True)"
        )
    points = checked_cloud(cloud.points)
    # s2 of smoothed points.
    smoothed = 1e-3
    noise_variance = noise_variance or smoothed
    check_fit(length_scale, SURFACE_OFFSET, max_points)
    chosen = farthest_points(points, min(max_points, len(points)))
    surface, normals = points[chosen], cloud.normals[chosen]
    # Below this cosine between normal and line of sight a normal is a guess.
    steep = np.einsum("ij,ij->i", normals, cloud.directions[chosen]) <= 0.15
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    free, free_by = _free_nodes(cloud.images, points)

    plane = None if table is None else np.asarray(table, dtype=float)
    if plane is not None and (points @ plane[:3] + plane[3] <= 0.0).all():
        raise PointCloudError(f"table = {plane.tolist()}: every point is below; turn its normal up")

    def fitted_to(count: int, hidden: Array, deviation: Array) -> tuple[Gpdf, int]:
        """The field of the first surface points, and the number of its nodes that rest on them."""
        seen, signed = _seen_nodes(surface[:count], normals[:count], steep[:count])
        under, under_by = _nodes_under(plane, np.concatenate([points, hidden]))
        # Errors of neighbouring nodes there correlate: this number counts as one observation.
        hidden_variance = 1.5 * (deviation / length_scale) ** 2
        made_up = np.zeros(len(hidden))
        others = len(seen) + len(free) + len(under)
        noise = np.concatenate([np.zeros(others), hidden_variance])
        fitted = fit_field(
            np.concatenate([seen, free, under, hidden]),
            np.exp(-np.concatenate([signed, free_by, under_by, made_up]) / length_scale),
            points=surface[:count],
            bounds=bounds,
            length_scale=length_scale,
            noise_variance=noise_variance + noise,
        )
        return fitted, len(seen)

    hidden, deviation = np.zeros((0, 3)), np.zeros(0)
    if learnt and cloud.images:
        rough, _ = fitted_to(ROUGH_POINTS, hidden, deviation)
        # Nodes on the hidden side, all views together.
        hidden, deviation = hidden_nodes(rough, cloud.images, points, load_hidden_side(), 120)
        if plane is not None:
            above = hidden @ plane[:3] + plane[3] > 0.0
            hidden, deviation = hidden[above], deviation[above]
    fitted, observed = fitted_to(len(surface), hidden, deviation)
    content = {f.name: getattr(fitted, f.name) for f in fields(Gpdf)} | {"table": plane}
    return CompletedField(
        **content, cloud=points, cloud_normals=cloud.normals, images=cloud.images, observed=observed
    )


def _seen_nodes(surface: Array, normals: Array, steep: Mask) -> tuple[Array, Array]:
    """Points of the surface and some on either side of it, and their signed distances from it."""
    # Share of the points that get such values.
    share = 0.15
    count = round(share * len(surface))
    beside = np.flatnonzero(~steep)[:count]  # the first ones cover the cloud evenly
    offset = SURFACE_OFFSET * normals[beside]
    nodes = np.concatenate([surface, surface[beside] + offset, surface[beside] - offset])
    offsets = [0.0, SURFACE_OFFSET, -SURFACE_OFFSET]
    return nodes, np.repeat(offsets, [len(surface), len(beside), len(beside)])


def _free_nodes(images: tuple[ViewImage, ...], points: Array) -> tuple[Array, Array]:
    """Points just beside the silhouettes, and how far at least the object is from them."""
    # Nodes in free space keep this distance from observed points [m].
    clearance = 5e-3
    if not images:
        return np.zeros((0, 3)), np.zeros(0)
    # Nodes in free space, all views together.
    nodes = np.concatenate([rim_points(image, 80 // len(images)) for image in images])
    distance = free_distance(images, nodes)
    apart = cKDTree(points).query(nodes, distance_upper_bound=clearance)[0]  # inf if further
    kept = (distance > 0.0) & (apart > clearance)
    return nodes[kept], distance[kept]


def _nodes_under(table: Array | None, points: Array) -> tuple[Array, Array]:
    """Nodes under a table where the object stands, inside the hull of its foot, and how deep."""
    # Surface that is no higher stands on the table; depth and distance of the nodes [m].
    standing, depth, spacing = 0.012, 5e-3, 0.01
    if table is None:
        return np.zeros((0, 3)), np.zeros(0)
    height = points @ table[:3] + table[3]
    across = np.stack(perpendiculars(table[:3]), axis=1)
    foot = points[height < standing] @ across
    if len(foot) < 3 or np.linalg.matrix_rank(foot - foot.mean(axis=0), tol=spacing) < 2:
        return np.zeros((0, 3)), np.zeros(0)
    axes = [np.arange(side.min(), side.max(), spacing) for side in foot.T]
    grid = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    inside = grid[Delaunay(foot, qhull_options="QJ").find_simplex(grid) >= 0]
    return inside @ across.T - (table[3] + depth) * table[:3], np.full(len(inside), depth)
