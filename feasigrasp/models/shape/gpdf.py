"""Gaussian process distance field (GPDF, Le Gentil et al. 2024): queries, expected error."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.geometry.points import farthest_points, nearest_distance
from feasigrasp.models.quantities import POINT, POINTS, ArrayOf, Count, NotNegative, Positive, Whole
from feasigrasp.models.shape import gpdf_kernels as kernels
from feasigrasp.models.shape.node_sums import cross_covariance, make_tiles


@dataclass(frozen=True, eq=False)
class SurfacePoints(Frozen):
    """Points of the completed surface.

    Attributes:
        points: Positions, shape (m, 3) [m].
        normals: Outward unit normals, shape (m, 3).
        variance_at: Predictive variance of the occupancy at points (k, 3), shape (k,).
    """

    points: Array
    normals: Array
    variance_at: Callable[[Array], Array] = field(repr=False)

    def __post_init__(self) -> None:
        self._freeze(points=self.points, normals=self.normals)

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    @cached_property
    def variance(self) -> Array:
        """Predictive variance of the occupancy, shape (m,); small at observations.

        Computed when it is asked for: it costs more than the points.
        """
        variance = self.variance_at(self.points)
        variance.flags.writeable = False
        return variance


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
        cross = cross_covariance(self.nodes, self.length_scale, self.center, np.asarray(x))
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
        return SurfacePoints(points[kept], normals[kept], self.variance)

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
        # Shortest step of a ray through the object [m].
        return kernels.march_to_exit(
            self.tiles,
            self.length_scale,
            np.asarray(starts) - self.center,
            np.asarray(directions),
            start_length,
            max_length,
            2e-3,
        )

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
        return make_tiles(self.nodes, self.alpha, self.length_scale)

    def _march(self, x: ArrayLike, steps: int) -> tuple[Array, Array, Array, Array]:
        marched: tuple[Array, Array, Array, Array] = kernels.refine(
            self.tiles, self.length_scale, self.center, np.asarray(x), steps, self.damped
        )
        return marched


def unit_normals(gradient: Array) -> Array:
    """Gradients (m, 3) of a distance scaled to unit length; zero where there is no gradient."""
    norm = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
    return gradient / np.maximum(norm, 1e-12)[:, None]


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
