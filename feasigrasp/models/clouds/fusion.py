"""Fusion of depth views in the object frame into one cloud of surfels.

Reference: Keller et al., "Real-time 3D reconstruction in dynamic scenes using point-based fusion",
3DV 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices, Mask
from feasigrasp.models.clouds.edges import Outline
from feasigrasp.models.clouds.smoothing import register_view, smooth_view
from feasigrasp.models.clouds.view_image import ViewImage, free_distance, view_image
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.quantities import POINT, POINTS, ArrayOf, NotNegative, Positive, Whole

#: Points of a view that lie deeper in the free space of earlier ones do not belong there [m].
#: Source: guessed.
_OUT_OF_PLACE = 0.01
#: Below this many points a view shows no surface. Source: guessed.
_MIN_SURFACE = 12


@dataclass(frozen=True, eq=False)
class FusedCloud(Frozen):
    """Observed surface points, one per voxel, with viewing directions.

    Attributes:
        points: In the object frame O, shape (n, 3) [m].
        directions: Unit directions from each point to the camera, in O, shape (n, 3).
        voxel_size: Edge length of a voxel [m].
        views: Number of views merged.
        smooth: Whether every view is smoothed and registered before it is merged. If so, a point
            that a view shows again is moved along its normal, in proportion to the view's certainty
            (surfels); the two sides of a thin wall, which face opposite ways, stay apart.
        normals: Outward unit normals, shape (n, 3); empty (0, 3) unless ``smooth``.
        weights: How sure each point is, shape (n,): inverse variance [1/m^2] if ``smooth``, else
            the number of views that saw it.
        images: The latest views' pictures; empty unless ``smooth``.
    """

    points: Annotated[Array, POINTS]
    directions: Annotated[Array, ArrayOf(("n", 3))]
    voxel_size: Positive
    views: Whole = 0
    smooth: bool = False
    normals: Annotated[Array, ArrayOf(("k", 3))] = field(default_factory=lambda: np.zeros((0, 3)))
    weights: Annotated[Array, ArrayOf(("w",))] = field(default_factory=lambda: np.zeros(0))
    images: tuple[ViewImage, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self, PointCloudError)
        for name in ("normals", "weights"):
            if len(getattr(self, name)) not in (0, len(self.points)):
                raise PointCloudError(
                    f"FusedCloud.{name} has {len(getattr(self, name))} rows; give none, or one for "
                    f"each of the {len(self.points)} points"
                )
        names = ("points", "directions", "normals", "weights")
        self._freeze(**{name: np.array(getattr(self, name)) for name in names})

    @classmethod
    @checked(PointCloudError)
    def empty(cls, voxel_size: Positive, smooth: bool = False) -> FusedCloud:
        """A cloud without points."""
        return cls(np.zeros((0, 3)), np.zeros((0, 3)), voxel_size, smooth=smooth)

    @checked(PointCloudError)
    def contradicted(
        self,
        points: Annotated[ArrayLike, POINTS],
        p_OC: Annotated[ArrayLike, POINT],
        outline: Outline | None = None,
    ) -> float:
        """Share of a view that contradicts earlier views, for a correct object pose.

        The share of its points that lies where earlier views looked through, or the share of the
        known points behind which it sees surface, whichever is larger, in [0, 1]; 0 without earlier
        pictures. The view is given as in `merged`.
        """
        if not self.images or len(self.points) == 0 or np.size(points) < 3 * _MIN_SURFACE:
            return 0.0
        view = np.asarray(points)
        reliable = [image.reliable for image in self.images]
        out_of_place = float(np.mean(free_distance(reliable, view) > _OUT_OF_PLACE))
        image = view_image(view, np.asarray(p_OC), outline)
        return max(out_of_place, _seen_through(image, self.points))

    @checked(PointCloudError)
    def merged(
        self,
        points: Annotated[ArrayLike, POINTS],
        p_OC: Annotated[ArrayLike, POINT],
        *,
        register: bool = True,
        outline: Outline | None = None,
        deviation: NotNegative = 0.0,
    ) -> FusedCloud:
        """Adds one view.

        A smoothed view is first registered to the earlier views. Every view has the same
        tracking error, so the correction is shared: the view moves by all but 1/(views + 1) of it,
        everything before by the rest, and the cloud settles at the mean of the tracked poses.

        Args:
            points: Surface points in O, shape (m, 3) [m].
            p_OC: Position of the camera in O, shape (3,) [m].
            register: Whether to. A view that was tracked by this very cloud has been already, and
                must not move it.
            outline: Where the object may go on beside its points, in O; nowhere if not given.
            deviation: Standard deviation of its place across its surface, as far as known [m].

        Returns:
            The cloud with the mean over the views in every voxel, or at every surfel.
        """
        points, camera = np.asarray(points), np.asarray(p_OC)
        # One mean point per voxel and view first, so that a view of many pixels weighs no more.
        at = grouped_means(points, voxel_keys(points, self.voxel_size), np.ones(len(points)))[0]
        towards = _units(camera - at)
        if not self.smooth:
            return self._averaged(at, towards)
        if len(at) < _MIN_SURFACE:
            return replace(self, views=self.views + 1)

        image = view_image(points, camera, outline)
        at, normals, sigma = smooth_view(points, at, camera)
        # Standard deviation of a view's place, across its surface, at least [m].
        weights = 1.0 / (np.square(sigma) + max(deviation, 5e-4) ** 2)
        old = self
        if self.views and register:
            X = register_view(at, normals, self.points, self.normals)
            back = se3.exp(-se3.log(X) / (self.views + 1))
            old, X = self._moved(back), back @ X
            at, towards, normals = _turn(X, at, True), _turn(X, towards), _turn(X, normals)
            image = image.moved(X)
        known = np.concatenate([old.points, at])
        agreeing = (_agreeing(each, known) for each in (*old.images, image))
        images = _kept([each for each in agreeing if each is not None])
        return old._fused(at, towards, normals, weights, images)

    @checked(PointCloudError)
    def without(self, gone: Annotated[Mask, ArrayOf(("n",), dtype=np.bool_)]) -> FusedCloud:
        """Leaves out some of the points, shape (n,)."""
        if len(gone) != len(self.points):
            raise PointCloudError(f"gone has {len(gone)} entries for {len(self.points)} points")
        kept = {
            name: getattr(self, name)[~gone]
            for name in ("points", "directions", "normals", "weights")
            if len(getattr(self, name)) == len(gone)
        }
        return replace(self, **kept)

    def _moved(self, X: Array) -> FusedCloud:
        """Everything after a rigid motion X (4, 4)."""
        return replace(
            self,
            points=_turn(X, self.points, True),
            directions=_turn(X, self.directions),
            normals=_turn(X, self.normals),
            images=tuple(image.moved(X) for image in self.images),
        )

    def _fused(
        self,
        at: Array,
        towards: Array,
        normals: Array,
        weights: Array,
        images: tuple[ViewImage, ...],
    ) -> FusedCloud:
        """With the surface of one more view."""
        rows = np.hstack([self.points, self.directions, self.normals])
        added = np.hstack([at, towards, normals])
        known = self.weights.copy()
        if len(rows) > 0:
            nearest = cKDTree(at).query(self.points)[1]
            again, height = self._surface_again(rows, known, added[nearest], weights[nearest])
            seen = cKDTree(self.points).query(at)[1]
            repeated, _ = self._surface_again(added, weights, rows[seen], known[seen])
            i = nearest[again]
            share = (weights[i] / (weights[i] + known[again]))[:, None]
            rows[again, :3] += share * height[again]
            rows[again, 3:] += share * (added[i, 3:] - rows[again, 3:])
            known[again] += weights[i]
            added, weights = added[~repeated], weights[~repeated]
        rows = np.concatenate([rows, added])
        return replace(
            self,
            points=rows[:, :3],
            directions=_units(rows[:, 3:6]),
            views=self.views + 1,
            normals=_units(rows[:, 6:]),
            weights=np.concatenate([known, weights]),
            images=images,
        )

    def _surface_again(
        self, rows: Array, weights: Array, others: Array, other_weights: Array
    ) -> tuple[Mask, Array]:
        """Which points others show again, and the way to those along the normals, (n, 3) [m].

        The rows (n, 9) are points, directions and normals; ``others`` are those nearest to them.
        """
        # A view shows a point again that is beside its nearest one by less than this share of a
        # voxel, apart from it by less than a number of standard deviations and a distance [m],
        # and faces the same way (cosine).
        beside_share, apart_sigmas, most_apart, same_side = 0.75, 6.0, 0.01, 0.3
        normals = _units(weights[:, None] * rows[:, 6:] + other_weights[:, None] * others[:, 6:])
        way = others[:, :3] - rows[:, :3]
        height = np.einsum("ij,ij->i", way, normals)
        along = height[:, None] * normals
        beside = np.linalg.norm(way - along, axis=1)
        apart = np.minimum(apart_sigmas * np.sqrt(1.0 / weights + 1.0 / other_weights), most_apart)
        alike = np.einsum("ij,ij->i", rows[:, 6:], others[:, 6:]) > same_side
        return alike & (beside < beside_share * self.voxel_size) & (np.abs(height) < apart), along

    def _averaged(self, at: Array, towards: Array) -> FusedCloud:
        """With one point per voxel of one more view."""
        rows = np.hstack([np.vstack([self.points, at]), np.vstack([self.directions, towards])])
        weights = np.concatenate([self.weights, np.ones(len(at))])
        rows, weights = grouped_means(rows, voxel_keys(rows[:, :3], self.voxel_size), weights)
        views, directions = self.views + 1, _units(rows[:, 3:])
        return replace(
            self, points=rows[:, :3], directions=directions, weights=weights, views=views
        )


def _units(vectors: Array) -> Array:
    """Of length 1, or 0."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, 1e-12))


def _kept(images: Sequence[ViewImage]) -> tuple[ViewImage, ...]:
    """The latest pictures, one per direction of those that are whole and of the others.

    Of too many those that differ most: what a camera once looked into, the inside of a cup above
    all, is not forgotten for many views of other sides.
    """
    # Pictures of earlier views that are kept, for the free space in them.
    max_images = 6
    chosen: list[ViewImage] = []
    for image in reversed(images):
        z = image.X_OC[:3, 2]
        like = (other for other in chosen if other.whole == image.whole)
        # A new picture replaces one from nearly the same direction (cosine).
        if all(z @ other.X_OC[:3, 2] < np.cos(np.deg2rad(15.0)) for other in like):
            chosen.append(image)
    if len(chosen) > max_images:
        directions = np.array([image.X_OC[:3, 2] for image in chosen])
        chosen = [chosen[i] for i in np.sort(farthest_points(directions, max_images))]
    return tuple(chosen[::-1])


def _seen_through(image: ViewImage, points: Array) -> float:
    """The share of the points in a view's silhouette that it sees through, in [0, 1].

    Points beside the silhouette say nothing: a hand may hide the object there. Nor do those where
    something was not measured: it may be them, too near to the camera.
    """
    row, column, z, inside = image.project(points)
    inside &= image.mask[row, column] & ~image.unclear[row, column]
    if np.count_nonzero(inside) < _MIN_SURFACE:
        return 0.0
    through = image.front[row, column] - z > _OUT_OF_PLACE
    return float(np.mean(through[inside]))


def _agreeing(image: ViewImage, points: Array) -> ViewImage | None:
    """The part of a view that contradicts no earlier one; None if empty.

    Where a hand hides a part of the object, or the picture ends, the silhouette is not the
    object's; then points that other views have shown lie in what looks like free space beside it.
    """
    # Points deeper in a view's free space contradict it [m]; the share of points that may.
    deep, most_deep = 6e-3, 0.03
    for shown in (image, replace(image, whole=False)):
        in_free_space = free_distance((shown,), points) > deep
        if float(np.mean(in_free_space)) < most_deep:
            return shown
    return None


def _turn(X: Array, vectors: Array, positions: bool = False) -> Array:
    turned = vectors @ X[:3, :3].T
    return np.asarray(turned + X[:3, 3] if positions else turned)


def voxel_keys(points: Array, voxel_size: float) -> Indices:
    """A number per point, equal for points that share a voxel and ordered by voxel, shape (n,)."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.int64)
    voxels = np.floor(points / voxel_size).astype(np.int64)
    voxels -= voxels.min(axis=0)
    extent = voxels.max(axis=0) + 1
    keys: Indices = (voxels[:, 0] * extent[1] + voxels[:, 1]) * extent[2] + voxels[:, 2]
    return keys


def grouped_means(rows: Array, keys: Indices, weights: Array) -> tuple[Array, Array]:
    """Weighted mean of the rows of each key, ordered by key, and the sums of their weights."""
    if len(rows) == 0:
        return rows, weights
    _, inverse = np.unique(keys, return_inverse=True)
    total = np.asarray(np.bincount(inverse, weights=weights), dtype=float)
    columns = [np.bincount(inverse, weights=weights * column) for column in rows.T]
    return np.stack(columns, axis=1) / total[:, None], total
