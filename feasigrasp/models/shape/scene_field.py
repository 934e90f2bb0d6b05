"""Distance field of the scene: the table and everything on it.

The same Gaussian process distance field as for objects (Choi & Figueroa, arXiv 2311.02576), on the
cloud of the surroundings, with three things that a scene needs:

- It is large, so it is cut into cubes with a field each, of bounded size, fitted to the points of
  its cube and a rim around it. A query then costs the same in a room as on a desk.
- Marching along the gradient from half a metre away ends anywhere but at the nearest surface: the
  occupancy of a whole table blends (measured: 30 mm mean error at 0 to 0.6 m). Here refinement
  starts at the nearest observed point, moves along the surface towards the query, and settles on
  the field's zero (2 mm; edges are rounded by up to half a voxel). The nearest point alone is too
  near by what noise lifts it, 3.6 mm for noise of 3 mm.
- What is behind a surface was not seen. Up to ``thickness`` behind it counts as inside.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.checks import MIN_POINTS, directions_to_camera
from feasigrasp.models.clouds.fusion import grouped_means, voxel_keys
from feasigrasp.models.clouds.observed_space import SCENE_VOXEL
from feasigrasp.models.quantities import POINTS, VIEW, ArrayOf, Bound, NotNegative, Positive
from feasigrasp.models.shape.gpdf import Gpdf, fit_gpdf

#: Edge length of the cubes with a field each [m]. Source: guessed.
_CUBE = 0.25
#: Points in a leaf of the look-up tree: of a point far from a plane many are nearly nearest, and
#: going through them beats going through branches by a factor of two. Source: measured.
_LEAF = 64


@dataclass(frozen=True, eq=False)
class SceneField(Frozen):
    """Distance to the surfaces of a scene, in the frame of its cloud; made by `fit_scene`.

    Attributes:
        points: The cloud, one point per voxel, shape (n, 3) [m].
        cube: Which of ``fields`` each point belongs to, shape (n,).
        fields: One distance field per cube; None where the points of the cube are too few for one,
            and stand for themselves.
        resolution: Edge length of a voxel [m].
        unobserved: Middles of voxels of `SCENE_VOXEL` that were never seen and may belong to what
            was, shape (k, 3) [m]; no part of the distance, which is that to the observed surface.
        thickness: Depth behind a seen surface that counts as inside [m].
    """

    points: Annotated[Array, POINTS]
    cube: Annotated[Indices, ArrayOf(("n",), dtype=np.int64)]
    fields: tuple[Gpdf | None, ...]
    resolution: Positive
    unobserved: Annotated[Array, ArrayOf(("k", 3), "m")]
    thickness: NotNegative = 0.05

    def __post_init__(self) -> None:
        check_fields(self, PointCloudError)
        if self.cube.size and not 0 <= self.cube.min() <= self.cube.max() < len(self.fields):
            raise PointCloudError(f"SceneField.cube is outside 0 ... {len(self.fields) - 1}")
        self._freeze(points=self.points, cube=self.cube, unobserved=self.unobserved)

    @checked(PointCloudError)
    def distance(self, x: Annotated[ArrayLike, POINTS]) -> Array:
        """Signed distance to the nearest surface at x (m, 3) [m], shape (m,)."""
        return self.distance_and_gradient(x)[0]

    @checked(PointCloudError)
    def distance_and_gradient(
        self, x: Annotated[ArrayLike, POINTS], max_distance: Bound = np.inf
    ) -> tuple[Array, Array]:
        """Signed distance to the nearest surface at x (m, 3) [m], and its gradient.

        Distances (m,) [m] are negative behind a surface, gradients (m, 3) are unit. Farther away
        than ``max_distance`` is far enough: that distance, with gradient zero. It saves most of the
        time where most points are far.
        """
        x = np.asarray(x)
        distance, gradient = np.full(len(x), max_distance), np.zeros_like(x)
        reach = max_distance + self.resolution  # a foot lies within a voxel of an observed point
        apart, nearest = self._tree.query(x, distance_upper_bound=reach)
        near = np.flatnonzero(np.isfinite(apart))
        d, g = self._at(x[near], nearest[near])
        closer = d < max_distance
        distance[near[closer]], gradient[near[closer]] = d[closer], g[closer]
        return distance, gradient

    def _at(self, x: Array, nearest: Indices) -> tuple[Array, Array]:
        """Distances and gradients at x, from the observed points nearest to x."""
        feet, normals = self._feet(x, nearest)
        offset = x - feet
        distance = np.linalg.norm(offset, axis=1)
        height = np.einsum("mi,mi->m", offset, normals)
        # Cosine to the outward normal below which a query lies behind the surface, not beside its
        # rim.
        inside = (height < -0.5 * distance) & (distance < self.thickness)
        sign = np.where(inside, -1.0, 1.0)
        gradient = offset * (sign / np.maximum(distance, 1e-12))[:, None]
        # Closer to the surface than this the field's own normal is the gradient [m].
        touching = distance < 1e-3
        gradient[touching] = normals[touching]
        return np.where(touching, height, sign * distance), gradient

    @checked(PointCloudError)
    def closer_than(self, x: Annotated[ArrayLike, POINTS], margin: float) -> Mask:
        """Mask of points x (m, 3) closer to a surface than a margin [m], or behind it, (m,).

        As `distance`, but most points far away cost a look-up only.
        """
        return self.distance_and_gradient(x, max(margin, self.thickness))[0] < margin

    @checked(PointCloudError)
    def unobserved_distance(
        self, x: Annotated[ArrayLike, POINTS], max_distance: Bound = np.inf
    ) -> Array:
        """Distance of points x (m, 3) to the voxels of ``unobserved``, taken for balls, (m,) [m].

        Farther than ``max_distance`` away, and if there are none, it is infinite.
        """
        radius = 0.5 * SCENE_VOXEL
        reach = max_distance + radius
        nearest, _ = self._unobserved_tree.query(np.asarray(x), distance_upper_bound=reach)
        return np.asarray(nearest - radius)

    def _feet(self, x: Array, nearest: Indices) -> tuple[Array, Array]:
        """Surface points (m, 3) about the nearest observed ones, and outward normals (m, 3)."""
        # Steps onto the surface, before and after moving along it towards the query.
        steps_before, steps_after = 1, 2
        start = self.points[nearest]
        feet, normals = start.copy(), np.zeros_like(x)
        cubes = self.cube[nearest]
        for cube in np.unique(cubes):
            gpdf, of_cube = self.fields[cube], np.flatnonzero(cubes == cube)
            if gpdf is None:
                continue
            _, p, n = gpdf.refine(start[of_cube], steps_before)
            p = p + _along(x[of_cube] - p, n, self.resolution / 2)
            _, p, normals[of_cube] = gpdf.refine(p, steps_after)
            feet[of_cube] += _shortened(p - start[of_cube], self.resolution)
        return feet, normals

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points, leafsize=_LEAF)

    @cached_property
    def _unobserved_tree(self) -> cKDTree:
        return cKDTree(self.unobserved, leafsize=_LEAF)


@checked(PointCloudError)
def fit_scene(
    points: Annotated[ArrayLike, POINTS],
    viewpoint: Annotated[ArrayLike, VIEW],
    *,
    resolution: Positive = 0.01,
) -> SceneField:
    """Fits the distance field of a scene.

    Args:
        points: Cloud of the surroundings without robot and object, shape (n, 3) [m]; any size.
        viewpoint: Where the camera was, shape (3,) [m], or, for merged views, the direction from
            each point to its camera, shape (n, 3).
        resolution: Edge length of the voxels in which points are averaged [m].

    Raises:
        PointCloudError: If the cloud is too small, of the wrong shape, or holds NaN or infinity.
    """
    # Points this far around a cube take part in its field, so that neighbours agree [m].
    rim = 0.04
    cloud = np.asarray(points)
    if len(cloud) < MIN_POINTS:
        raise PointCloudError(
            f"{len(cloud)} points of the scene; a field needs at least {MIN_POINTS}. Is the label "
            "image that of the same camera?"
        )
    towards = directions_to_camera(cloud, viewpoint)
    towards = towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-12)
    rows, keys = np.hstack([cloud, towards]), voxel_keys(cloud, resolution)
    means, _ = grouped_means(rows, keys, np.ones(len(cloud)))
    thin, directions = np.ascontiguousarray(means[:, :3]), means[:, 3:]
    cells = np.floor(thin / _CUBE + 0.5).astype(np.int64)  # a table at 0 stays in one
    corners, cube = np.unique(cells, axis=0, return_inverse=True)
    fields: list[Gpdf | None] = []
    for low in (corners - 0.5) * _CUBE:
        inside = ((thin > low - rim) & (thin < low + _CUBE + rim)).all(axis=1)
        rows, seen_from = thin[inside], directions[inside]
        try:
            fields.append(
                fit_gpdf(rows, viewpoint=seen_from, length_scale=0.1, surface_offset=5e-3)
            )
        except PointCloudError:  # a handful of points
            fields.append(None)
    cube = cube.reshape(-1).astype(np.int64)
    return SceneField(thin, cube, tuple(fields), resolution, np.zeros((0, 3)))


def _along(vectors: Array, normals: Array, length: float) -> Array:
    """The part of vectors along a surface, shortened to a length."""
    height = np.einsum("mi,mi->m", vectors, normals)
    return _shortened(vectors - height[:, None] * normals, length)


def _shortened(vectors: Array, length: float) -> Array:
    norm = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, length / np.maximum(norm, 1e-12))
