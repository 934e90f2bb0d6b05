"""Gaussian process distance field (GPDF): a partial point cloud becomes a completed surface.

A Gaussian process with the Matern-1/2 kernel ``k(r) = exp(-r / l)`` interpolates occupancy 1 on
the observed points; because the kernel inverts in closed form, occupancy becomes distance:
``o(x) = k(x, X) (K + s2 I)^-1 y`` and ``d(x) = -l ln o(x)`` (Choi & Figueroa, arXiv 2311.02576,
"Shape Completion with Distance Field Refinement"). Inside the object o > 1 and d < 0, so o is
never clamped at 1.

Deviation from the paper: beside a third of the points, values at ``+-surface_offset`` along the
normal, ``y = exp(-+h / l)``, tell the process which side is inside. Without them one third of the
inside has the wrong sign for a single view. ``surface_offset=None`` gives the paper's field.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from feasigrasp.errors import PointCloudError
from feasigrasp.models import gpdf_kernels as kernels
from feasigrasp.models.point_cloud_checks import MIN_POINTS as MIN_POINTS
from feasigrasp.models.point_cloud_checks import check_fit, checked_cloud, directions_to_camera
from feasigrasp.models.point_normals import outward_normals
from feasigrasp.models.surface_points import SurfacePoints

Array = NDArray[np.float64]

#: Above this many points the cloud is thinned evenly before farthest-point selection.
_MAX_CANDIDATES = 2048
#: Shortest step of a ray through the object [m].
_RAY_STEP = 2e-3


@dataclass(frozen=True, eq=False)
class Gpdf:
    """A fitted distance field, in the frame of the points it was fitted to.

    In the pipeline that is the object frame O, so a moving object needs no new fit. Immutable; make
    it with ``fit_gpdf``.

    Attributes:
        points: Surface points in use, shape (n, 3) [m].
        bounds: Lower and upper corner of the whole cloud, shape (2, 3) [m].
        length_scale: l of the kernel [m].
        noise_variance: s2, variance of the occupancy observations.
        center: Mean of ``points``; the kernels work relative to it, shape (3,).
        nodes: All nodes of the process (points, then offset points), centred, shape (3, k).
        alpha: Their weights ``(K + s2 I)^-1 y``, shape (k,).
        cholesky: Lower Cholesky factor of ``K + s2 I``, shape (k, k), Fortran order.
    """

    points: Array
    bounds: Array
    length_scale: float
    noise_variance: float
    center: Array
    nodes: Array
    alpha: Array
    cholesky: Array

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("points", "bounds", "center", "nodes", "alpha", "cholesky"):
            getattr(self, name).flags.writeable = False

    def __deepcopy__(self, memo: dict[int, Any]) -> Gpdf:
        """Immutable, so a copy is itself."""
        return self

    def distance(self, x: ArrayLike) -> Array:
        """Raw signed distance ``d = -l ln o``.

        Its sign and zero are right; its size is not: 10-30 % too small outside, half or less
        inside. Use ``refine`` where metres matter.

        Args:
            x: Query points, shape (m, 3) [m].

        Returns:
            Shape (m,) [m].
        """
        return kernels.values(self.nodes, self.alpha, self.length_scale, self._centred(x))

    def distance_and_gradient(self, x: ArrayLike) -> tuple[Array, Array]:
        """Raw signed distance (m,) and its gradient ``-(l / o) grad o`` (m, 3) at x (m, 3)."""
        return kernels.values_and_gradients(
            self.nodes, self.alpha, self.length_scale, self._centred(x)
        )

    def normals(self, x: ArrayLike) -> Array:
        """Outward unit normals ``grad d / |grad d|`` at x (m, 3), shape (m, 3)."""
        gradient = self.distance_and_gradient(x)[1]
        norm = np.linalg.norm(gradient, axis=1, keepdims=True)
        return gradient / np.maximum(norm, 1e-12)

    def variance(self, x: ArrayLike) -> Array:
        """Predictive variance ``1 - k (K + s2 I)^-1 k^T`` of the occupancy at x (m, 3), (m,).

        Small near observed points, growing towards 1 away from them.
        """
        cross = kernels.cross_covariance(self.nodes, self.length_scale, self._centred(x))
        solved, info = lapack.dtrtrs(self.cholesky, cross.T, lower=1, overwrite_b=1)
        if info != 0:
            raise PointCloudError(f"variance: triangular solve failed (LAPACK info {info})")
        return np.maximum(1.0 - np.einsum("ij,ij->j", solved, solved), 0.0)

    def refine(self, x: ArrayLike, steps: int = 5) -> tuple[Array, Array, Array]:
        """Refined signed distance by marching to the surface.

        Repeats ``x <- x - step n`` with the unit normal n recomputed at every step (the paper's
        scripts freeze it) and the damped Newton step ``d / max(|grad d|, 0.2)``, at most 2.5 d,
        since ``|grad d|`` is 0.04 to 0.9 and not 1.

        Args:
            x: Query points, shape (m, 3) [m].
            steps: Number of steps.

        Returns:
            Signed distance (m,) [m], the surface points reached (m, 3), outward normals there.
        """
        travelled, ends, normals, _ = self._march(x, steps)
        return travelled, ends, normals

    def surface(self, n: int = 8, steps: int = 5, tolerance: float = 1e-3) -> SurfacePoints:
        """The completed surface: an n x n x n grid round the cloud projected onto it.

        The grid fills the cloud's bounding box, grown by half its size on every side, with no half
        size below 0.3 of the largest. Grid points that do not reach ``|d| < tolerance`` are
        dropped.
        """
        middle, half = self.bounds.mean(axis=0), np.ptp(self.bounds, axis=0) / 2
        half = 2.0 * np.maximum(half, 0.3 * half.max())
        axes = np.linspace(middle - half, middle + half, n)
        grid = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1).reshape(-1, 3)
        _, points, normals, residual = self._march(grid, steps)
        reached = np.abs(residual) < tolerance
        points = points[reached]
        return SurfacePoints(points, normals[reached], self.variance(points))

    @cached_property
    def completion(self) -> SurfacePoints:
        """``surface()`` with its defaults, computed once for samplers, filters and pictures."""
        return self.surface()

    def ray_exits(
        self, starts: ArrayLike, directions: ArrayLike, max_length: float, start_length: float
    ) -> Array:
        """Where rays through the object come out on the far side.

        Args:
            starts: Points on the surface, shape (m, 3) [m].
            directions: Unit vectors into the object, shape (m, 3).
            max_length: Longest way looked at [m].
            start_length: First point looked at; must be inside the object [m].

        Returns:
            Length to the exit, shape (m,) [m]; NaN where there is none.
        """
        return kernels.march_to_exit(
            self.nodes,
            self.alpha,
            self.length_scale,
            self._centred(starts),
            np.array(directions, dtype=float, order="C"),
            start_length,
            max_length,
            _RAY_STEP,
        )

    def touches(self, poses: ArrayLike, body_points: ArrayLike, margin: float) -> NDArray[np.bool_]:
        """Whether a rigid body comes closer to the completed surface than a margin.

        Args:
            poses: Poses of the body in the field's frame, shape (m, 4, 4).
            body_points: Points on the body in its own frame, shape (k, 3) [m].
            margin: Least refined distance allowed [m].

        Returns:
            Shape (m,), True where a point of the body is too close or inside.
        """
        centred = np.array(poses, dtype=float, order="C")
        centred[:, :3, 3] -= self.center
        reach = self.completion.points - self.center
        box = np.stack([reach.min(axis=0) - margin, reach.max(axis=0) + margin])
        body = np.array(body_points, dtype=float, order="C")
        hits = kernels.first_hits(
            self.nodes,
            self.alpha,
            self.length_scale,
            centred,
            body[kernels.farthest_points(body, len(body))],  # coarse to fine clears most points
            box,
            margin,
        )
        return hits >= 0

    def _march(self, x: ArrayLike, steps: int) -> tuple[Array, Array, Array, Array]:
        travelled, ends, normals, residual = kernels.refine(
            self.nodes, self.alpha, self.length_scale, self._centred(x), steps
        )
        return travelled, ends + self.center, normals, residual

    def _centred(self, x: ArrayLike) -> Array:
        points = np.array(x, dtype=float, order="C")
        if points.ndim != 2 or points.shape[1] != 3:
            raise PointCloudError(f"query points have shape {points.shape}; give (m, 3)")
        if not np.isfinite(points).all():
            raise PointCloudError("query points hold NaN or infinity; drop those rows first")
        points -= self.center
        return points


def fit_gpdf(
    points: ArrayLike,
    *,
    length_scale: float = 0.3,
    noise_variance: float = 0.0025,
    surface_offset: float | None = 0.002,
    max_points: int = 320,
    viewpoint: ArrayLike | None = None,
) -> Gpdf:
    """Fits the distance field to a point cloud of one object.

    Args:
        points: Cloud, shape (n, 3) [m], in any frame; the field lives in the same frame.
        length_scale: l of the kernel [m]; large values complete unseen parts, small ones do not.
        noise_variance: s2; 0.0025 suits 1 mm of depth noise, 0.01 suits 3 mm.
        surface_offset: h of the values beside a third of the points [m]; None for the paper's
            field, which has none.
        max_points: Surface points kept, chosen by farthest-point selection (no random numbers).
        viewpoint: Where the camera was, shape (3,) [m], or the direction from each point to its
            camera, shape (n, 3). Orients the normals; without it they point away from the centroid.

    Raises:
        PointCloudError: If the cloud has the wrong shape, too few points, NaN or infinity, no
            extent or an absurd one, or if a parameter is out of range.
    """
    cloud = checked_cloud(points)
    check_fit(length_scale, noise_variance, surface_offset, max_points)
    bounds = np.stack([cloud.min(axis=0), cloud.max(axis=0)])
    directions = directions_to_camera(cloud, viewpoint)

    if len(cloud) > _MAX_CANDIDATES:
        even = np.linspace(0, len(cloud) - 1, max(_MAX_CANDIDATES, max_points)).astype(int)
        cloud = cloud[even]
        directions = None if directions is None else directions[even]
    chosen = kernels.farthest_points(cloud, min(max_points, len(cloud)))
    surface = cloud[chosen]
    center = surface.mean(axis=0)

    nodes, targets = surface, np.ones(len(surface))
    if surface_offset is not None:
        beside = chosen[: -(-len(chosen) // 3)]  # the first third covers the cloud evenly
        at, normals = outward_normals(
            cloud, beside, None if directions is None else directions[beside]
        )
        nodes = np.concatenate(
            [surface, at + surface_offset * normals, at - surface_offset * normals]
        )
        value = np.exp(-surface_offset / length_scale)
        targets = np.concatenate([targets, np.full(len(at), value), np.full(len(at), 1.0 / value)])

    centred = np.ascontiguousarray((nodes - center).T)
    gram = kernels.gram_lower(centred, length_scale, noise_variance).T
    factor, info = lapack.dpotrf(gram, lower=1, overwrite_a=1, clean=0)
    if info != 0:
        raise PointCloudError(
            f"the kernel matrix is not positive definite (LAPACK info {info}); "
            f"raise noise_variance (now {noise_variance:g})"
        )
    alpha, _ = lapack.dpotrs(factor, targets, lower=1)
    return Gpdf(
        points=surface,
        bounds=bounds,
        length_scale=float(length_scale),
        noise_variance=float(noise_variance),
        center=center,
        nodes=centred,
        alpha=np.ascontiguousarray(alpha.ravel()),
        cholesky=factor,
    )
