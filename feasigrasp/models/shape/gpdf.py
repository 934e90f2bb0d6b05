"""Gaussian process distance field (GPDF, Le Gentil et al. 2024): fit, queries, expected error.

A Gaussian process with the Matern-1/2 kernel ``k(r) = exp(-r / l)`` interpolates occupancy 1 on
the observed points; because the kernel inverts in closed form, occupancy becomes distance:
``o(x) = k(x, X) (K + s2 I)^-1 y`` and ``d(x) = -l ln o(x)`` (Choi & Figueroa, arXiv 2311.02576,
"Shape Completion with Distance Field Refinement"). Inside the object o > 1 and d < 0, so o is
never clamped at 1.

Deviation from the paper: beside some of the points, values at ``+-surface_offset`` along the
normal, ``y = exp(-+h / l)``, give the process the inside. Without them one third of the
inside has the wrong sign for a single view. ``surface_offset=None`` gives the paper's field.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.checks import check_fit, checked_cloud, directions_to_camera
from feasigrasp.models.geometry.points import farthest_points, nearest_distance
from feasigrasp.models.quantities import (
    CLOUD,
    POINT,
    POINTS,
    VIEW,
    ArrayOf,
    Count,
    NotNegative,
    Positive,
    Whole,
)
from feasigrasp.models.shape import gpdf_kernels as kernels
from feasigrasp.models.shape import node_sums


@dataclass(frozen=True, eq=False)
class SurfacePoints(Frozen):
    """Points of the completed surface.

    Attributes:
        points: Positions, shape (m, 3) [m].
        normals: Outward unit normals, shape (m, 3).
    """

    points: Array
    normals: Array

    def __post_init__(self) -> None:
        self._freeze(points=self.points, normals=self.normals)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)


@dataclass(frozen=True, eq=False)
class Gpdf(Frozen):
    """A fitted distance field, in the frame of the points it was fitted to.

    In the pipeline that is the object frame O, so a moving object needs no new fit. Immutable; make
    it with ``fit_gpdf``.

    Attributes:
        points: Surface points in use, shape (n, 3) [m].
        bounds: Lower and upper corner of the whole cloud, shape (2, 3) [m].
        length_scale: l of the kernel [m].
        noise_variance: s2, variance of the occupancy observations, one per node, shape (k,).
        center: Mean of ``points``; the kernels work relative to it, shape (3,).
        nodes: All nodes of the process (points, then offset points), centred, shape (3, k).
        alpha: Their weights ``(K + diag(s2))^-1 y``, y the occupancies given at them, shape (k,).
        cholesky: Cholesky factor of ``K + diag(s2)``, shape (k, k), Fortran order; only its lower
            triangle means anything.
        damped: Whether ``refine`` takes damped Newton steps; if not, the paper's steps of d.
        table: Plane that the object stands on, unit normal n and offset d: ``n . x + d`` is the
            height of x [m], shape (4,); None if there is none.
        has_free_space: Whether `possible` depends on free space.
    """

    points: Annotated[Array, POINTS]
    bounds: Annotated[Array, ArrayOf((2, 3), "m")]
    length_scale: Positive
    noise_variance: Annotated[Array, ArrayOf(("k",))]
    center: Annotated[Array, POINT]
    nodes: Annotated[Array, ArrayOf((3, "k"), "m")]
    alpha: Annotated[Array, ArrayOf(("k",))]
    cholesky: Annotated[Array, ArrayOf(("k", "k"), finite=False, order="K")]
    damped: bool = True
    table: Annotated[Array, ArrayOf((4,))] | None = None
    has_free_space: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_fields(self, PointCloudError)
        if self.table is not None and not abs(np.linalg.norm(self.table[:3]) - 1.0) < 1e-6:
            raise PointCloudError(
                f"table = {self.table}; give a unit normal and an offset in metres"
            )
        self._freeze(**{k: v for k, v in vars(self).items() if isinstance(v, np.ndarray)})

    def seen(self) -> tuple[Array, Array]:
        """Observed points (n, 3) [m] and outward normals, zero where undetermined."""
        return self.points, np.zeros_like(self.points)

    @checked(PointCloudError)
    def possible(self, x: Annotated[Array, POINTS]) -> Mask:
        """Mask of points (m, 3) outside observed free space, shape (m,)."""
        return np.ones(len(x), dtype=bool)

    @checked(PointCloudError)
    def distance(self, x: Annotated[ArrayLike, POINTS]) -> Array:
        """Raw signed distance ``d = -l ln o`` at x (m, 3), shape (m,) [m].

        Its sign and zero are right; its size is not: 10-30 % too small outside, half or less
        inside. Use ``refine`` where metres matter.
        """
        return kernels.values(self.tiles, self.length_scale, self.center, np.asarray(x))

    @checked(PointCloudError)
    def distance_and_gradient(self, x: Annotated[ArrayLike, POINTS]) -> tuple[Array, Array]:
        """Raw signed distance (m,) and its gradient ``-(l / o) grad o`` (m, 3) at x (m, 3)."""
        return kernels.values_and_gradients(
            self.tiles, self.length_scale, self.center, np.asarray(x)
        )

    @checked(PointCloudError)
    def normals(self, x: Annotated[ArrayLike, POINTS]) -> Array:
        """Outward unit normals ``grad d / |grad d|`` at x (m, 3), shape (m, 3)."""
        return unit_normals(self.distance_and_gradient(x)[1])

    @checked(PointCloudError)
    def variance(self, x: Annotated[ArrayLike, POINTS]) -> Array:
        """Predictive variance ``1 - k (K + s2 I)^-1 k^T`` of the occupancy at x (m, 3), (m,).

        Small near observed points, growing towards 1 away from them.
        """
        cross = node_sums.cross_covariance(
            self.nodes, self.length_scale, self.center, np.asarray(x)
        )
        solved, _ = lapack.dtrtrs(self.cholesky, cross.T, lower=1, overwrite_b=1)
        return np.maximum(1.0 - np.einsum("ij,ij->j", solved, solved), 0.0)

    @checked(PointCloudError)
    def refine(
        self, x: Annotated[ArrayLike, POINTS], steps: Whole = 5
    ) -> tuple[Array, Array, Array]:
        """Refined signed distance of points x (m, 3) by marching to the surface.

        Repeats ``x <- x - step n`` with the unit normal n recomputed at every step (the paper's
        scripts freeze it) and the damped Newton step ``d / max(|grad d|, 0.2)``, at most 2.5 d,
        since ``|grad d|`` is 0.04 to 0.9 and not 1. A field with ``damped=False`` steps by d.

        Returns:
            Signed distance (m,) [m], the surface points reached (m, 3), outward normals there.
        """
        return self._march(x, steps)[:3]

    @checked(PointCloudError)
    def surface(self, n: Count = 8) -> SurfacePoints:
        """The completed surface: an n x n x n grid round the cloud projected onto it.

        The grid fills `search_box`. Grid points that do not reach ``|d| < 1 mm`` in five steps are
        dropped, and so is what lies in known free space.
        """
        lower, upper = self.search_box
        axes = np.linspace(lower, upper, n)
        grid = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
        _, points, normals, residual = self._march(grid, 5)
        kept = np.abs(residual) < 1e-3
        kept[kept] = self.possible(points[kept])
        return SurfacePoints(points[kept], normals[kept])

    @property
    def search_box(self) -> Array:
        """Lower and upper corner of the surface search, shape (2, 3) [m].

        The cloud's bounding box, grown by half its size on every side, with no half size below 0.3
        of the largest.
        """
        middle, half = self.bounds.mean(axis=0), np.ptp(self.bounds, axis=0) / 2
        half = 2.0 * np.maximum(half, 0.3 * half.max())
        return np.stack([middle - half, middle + half])

    @cached_property
    def completion(self) -> SurfacePoints:
        """``surface()`` with its defaults, computed once for samplers, filters and pictures."""
        return self.surface()

    @checked(PointCloudError)
    def ray_exits(
        self,
        starts: Annotated[ArrayLike, POINTS],
        directions: Annotated[ArrayLike, POINTS],
        max_length: NotNegative,
        start_length: NotNegative,
    ) -> Array:
        """Lengths of rays through the object to their exits, (m,) [m]; NaN where there is none.

        They start on the surface, with unit vectors into the object, (m, 3) each. They are looked
        at from ``start_length`` on, which must be inside the object, up to ``max_length`` [m].
        """
        rays = np.asarray(starts) - self.center, np.asarray(directions)
        # The last is the shortest step of a ray through the object [m].
        lengths = start_length, max_length, 2e-3
        return kernels.march_to_exit(self.tiles, self.length_scale, *rays, *lengths)

    @checked(PointCloudError)
    def clearance(
        self,
        poses: Annotated[ArrayLike, ArrayOf(("m", 4, 4), "m", rotation=True)],
        body_points: Annotated[ArrayLike, ArrayOf(("k", 3), "m")],
        far: NotNegative,
        near: float,
    ) -> tuple[Array, Indices]:
        """Clearance of a rigid body from the completed surface.

        Of the body's poses in the field's frame (m, 4, 4), by points on it in its own (k, 3) [m].

        Returns:
            Least refined distance (m,), negative inside and ``far`` at most [m], and the index of
            the body point that has it, -1 where it is far, shape (m,). Of bodies closer than
            ``near`` [m], those of the first such point.
        """
        centred = np.array(poses)
        centred[:, :3, 3] -= self.center
        reach = self.completion.points - self.center
        box = np.stack([reach.min(axis=0) - far, reach.max(axis=0) + far])
        body = np.asarray(body_points)
        if len(body) == 0:
            raise PointCloudError("Gpdf.clearance: body_points is empty; give one point or more")
        order = farthest_points(body, len(body))  # coarse to fine clears most points
        distance, index = kernels.closest_points(
            self.tiles, self.length_scale, centred, body[order], box, far, near
        )
        return distance, np.where(index < 0, -1, order[index])

    @cached_property
    def tiles(self) -> Array:
        """Nodes and weights as the kernels of `node_sums` take them."""
        return node_sums.make_tiles(self.nodes, self.alpha, self.length_scale)

    def _march(self, x: ArrayLike, steps: int) -> tuple[Array, Array, Array, Array]:
        marched: tuple[Array, Array, Array, Array] = kernels.refine(
            self.tiles, self.length_scale, self.center, np.asarray(x), steps, self.damped
        )
        return marched


def unit_normals(gradient: Array) -> Array:
    """Gradients (m, 3) of a distance scaled to unit length; zero where there is no gradient."""
    norm = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
    return gradient / np.maximum(norm, 1e-12)[:, None]


@checked(PointCloudError)
def fit_gpdf(
    points: Annotated[ArrayLike, CLOUD],
    *,
    length_scale: Positive = 0.3,
    noise_variance: Positive = 0.0025,
    surface_offset: Positive | None = 0.002,
    max_points: Count = 320,
    viewpoint: Annotated[ArrayLike, VIEW] | None = None,
    damped: bool = True,
) -> Gpdf:
    """Fits the distance field to a point cloud of one object.

    Args:
        points: Cloud, shape (n, 3) [m], in any frame; the field lives in the same frame.
        length_scale: l of the kernel [m]; large values complete unseen parts, small ones do not.
        noise_variance: s2; 0.0025 suits 1 mm of depth noise, 0.01 suits 3 mm.
        surface_offset: h of the values beside a third of the points [m]; None for the paper's
            field, which has none.
        max_points: Surface points kept, chosen by farthest-point selection, corners first (no
            random numbers).
        viewpoint: Where the camera was, shape (3,) [m], or the direction from each point to its
            camera, shape (n, 3). Orients the normals; without it they point away from the centroid.
        damped: Whether ``Gpdf.refine`` takes damped Newton steps; False for the paper's steps.

    Raises:
        PointCloudError: If the cloud has the wrong shape, too few points, NaN or infinity, no
            extent or an absurd one, or if a parameter is out of range.
    """
    # Above this many points the cloud is thinned evenly before farthest-point selection.
    max_candidates = 2048
    cloud = checked_cloud(points)
    check_fit(length_scale, surface_offset, max_points)
    bounds = np.stack([cloud.min(axis=0), cloud.max(axis=0)])
    directions = None if viewpoint is None else directions_to_camera(cloud, viewpoint)

    if len(cloud) > max_candidates:
        even = np.linspace(0, len(cloud) - 1, max(max_candidates, max_points)).astype(int)
        cloud = cloud[even]
        directions = None if directions is None else directions[even]
    count = min(max_points, len(cloud))
    # One chosen point in this number is one that sticks out: the corners.
    outward = count // 8
    chosen = farthest_points(cloud, count, outward)
    surface = cloud[chosen]

    nodes, targets = surface, np.ones(len(surface))
    if surface_offset is not None:
        # Those chosen early cover the cloud evenly; at corners there is no normal.
        beside = chosen[outward : outward - (-count // 3)]
        towards = None if directions is None else directions[beside]
        at, normals = _outward_normals(cloud, beside, towards)
        offset = surface_offset * normals
        nodes = np.concatenate([surface, at + offset, at - offset])
        value = np.exp(-surface_offset / length_scale)
        targets = np.concatenate([targets, np.full(len(at), value), np.full(len(at), 1.0 / value)])
    return fit_field(
        nodes,
        targets,
        points=surface,
        bounds=bounds,
        length_scale=length_scale,
        noise_variance=noise_variance,
        damped=damped,
    )


def fit_field(
    nodes: ArrayLike,
    targets: ArrayLike,
    *,
    points: ArrayLike,
    bounds: ArrayLike,
    length_scale: float,
    noise_variance: float | ArrayLike,
    damped: bool = True,
) -> Gpdf:
    """Fits the process to occupancies at given nodes: the lower level of ``fit_gpdf``.

    Use it where the nodes are not just observed points, for example with values in free space,
    ``exp(-dist / l)`` at ``dist`` from the surface. Solves ``(K + diag(s2)) alpha = y``. The
    field is in the frame of the nodes.

    Args:
        nodes: Where the occupancy is given, shape (k, 3) [m].
        targets: The occupancy y there, shape (k,): 1 on the surface, less outside, more inside.
        points: Surface points among them, shape (n, 3) [m]; what ``Gpdf.points`` hands on.
        bounds: Lower and upper corner of the observed cloud, shape (2, 3) [m].
        length_scale: l of the kernel [m].
        noise_variance: s2 of every node, or one per node, shape (k,).
        damped: Whether ``Gpdf.refine`` takes damped Newton steps.

    Raises:
        PointCloudError: If the kernel matrix is not positive definite, or if the nodes reach
            hundreds of length scales from the centre of the points.
    """
    surface = np.array(points, dtype=float)
    center = surface.mean(axis=0)
    centred = np.ascontiguousarray((np.asarray(nodes, dtype=float) - center).T)
    radius = float(np.sqrt(np.einsum("ij,ij->j", centred, centred).max()))
    most = node_sums.MAX_NODE_RADIUS / node_sums.LOG2_E
    if not radius / length_scale <= most:
        raise PointCloudError(
            f"nodes reach {radius:.3g} m from the centre, {radius / length_scale:.0f} times "
            f"length_scale ({length_scale:g} m), and at most {most:.0f} times can be computed; "
            "raise length_scale, and look for NaN among the nodes"
        )
    y = np.array(targets, dtype=float)
    noise = np.broadcast_to(np.asarray(noise_variance, dtype=float), len(y)).copy()
    gram = node_sums.gram_lower(centred, length_scale, noise).T
    factor, info = lapack.dpotrf(gram, lower=1, overwrite_a=1, clean=0)
    if info != 0:
        raise PointCloudError(
            f"the kernel matrix is not positive definite (LAPACK info {info}); "
            f"raise noise_variance (now {noise.min():g} at least)"
        )
    return Gpdf(
        points=surface,
        bounds=np.array(bounds, dtype=float),
        length_scale=float(length_scale),
        noise_variance=noise,
        center=center,
        nodes=centred,
        alpha=np.asarray(lapack.dpotrs(factor, y, lower=1)[0]),
        cholesky=np.asarray(factor),
        damped=damped,
    )


def _outward_normals(
    cloud: Array, indices: Indices, towards_camera: Array | None
) -> tuple[Array, Array]:
    """Some points of a cloud (n, 3) and outward unit normals there, by principal components.

    A normal is turned to the camera's side, or, without a camera, away from the centroid. Where
    that is undecided (normal nearly perpendicular to the reference) the point is left out:
    a normal with the wrong sign does more harm than none.
    """
    at = cloud[indices]
    # Points that a plane is fitted to for a normal.
    _, near = cKDTree(cloud).query(at, k=min(20, len(cloud)))
    patch = cloud[near]
    patch = patch - patch.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("mki,mkj->mij", patch, patch))
    normals = vectors[:, :, 0]
    reference = at - cloud.mean(axis=0) if towards_camera is None else towards_camera
    length = np.maximum(np.linalg.norm(reference, axis=1), 1e-12)
    cosine = np.einsum("mi,mi->m", normals, reference) / length
    # Below this |cosine| between a normal and its reference direction its sign is a guess.
    reliable = np.abs(cosine) > 0.15
    return at[reliable], (normals * np.sign(cosine)[:, None])[reliable]


# Expected error of the completed surface as a function of distance to observations.
#
# The distance from the nearest observed point says nearly all about it: neither the full variance
# of the Gaussian process nor what the hidden-side network expects of itself predicts the error
# better.

#: Clearances grow by this share of the predicted deviation of the surface. Source: guessed.
MARGIN_GROWTH = 0.5
#: Surface this far from all that was seen may not be there at all [m]. Source: guessed.
INVENTED = 0.010


def predicted_deviation(apart: ArrayLike) -> Array:
    """Expected distance of completed surface from the true one, ``apart`` from observed points [m].

    The two coefficients are calibrated on the built-in objects (``feasigrasp evaluate shape`` draws
    how well they do on these and on others).
    """
    # Error of observed surface [m], and its growth with the distance from it.
    error_of_seen, error_growth = 0.0002, 0.21
    return np.asarray(error_of_seen + error_growth * np.asarray(apart))


def surface_deviation(field: Gpdf, x: Array) -> Array:
    """Expected distance of a field's surface at x (m, 3) from the true one, shape (m,) [m]."""
    return predicted_deviation(nearest_distance(np.ascontiguousarray(x), field.points))
