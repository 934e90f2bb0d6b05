"""Shape model of a tracker: distance field with its observed part."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.tracking.information import NOISE_SHARE, jacobian

#: Points of the model that are looked for in an image.
_PROBES = 300
#: Rigid displacements for the error of the normals, and how far they move the points [m].
_DISPLACEMENTS, _DISPLACED = 4, 4e-3
#: Neighbours of an observed point that decide whether the surface goes on around it, and how far
#: off their middle is at an edge, in units of their distance.
_NEIGHBOURS, _ONE_SIDED = 16, 0.25
#: Such an edge is that of an image, and not of the object, near to where one ended [m].
_NEAR_CUT = 0.01
#: Slopes of the raw distance below this are no slopes, as in the field's own Newton step.
_LEAST_SLOPE = 0.2


@dataclass(frozen=True, eq=False)
class TrackedModel(Frozen):
    """A field with the points that it was fitted to.

    Attributes:
        gpdf: The field, in O.
        cut: Points of the object where an image that it was learnt from ended, in O, shape (k, 3).
    """

    gpdf: Gpdf
    cut: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @cached_property
    def points(self) -> Array:
        """Observed points in O, shape (n, 3) [m]."""
        return self.gpdf.seen()[0]

    @cached_property
    def normals(self) -> Array:
        """Their outward unit normals, shape (n, 3)."""
        points, normals = self.gpdf.seen()
        return normals if np.any(normals) else self.gpdf.normals(points)

    @cached_property
    def tree(self) -> cKDTree:
        """For the observed point nearest to another."""
        return cKDTree(self.points)

    @cached_property
    def open_ends(self) -> Mask:
        """Mask of points where the observed surface ends at an image border, (n,).

        Nothing is known of what is beyond, not even that the object ends there, as its silhouette
        would tell.
        """
        if len(self.cut) == 0:
            return np.zeros(len(self.points), dtype=bool)
        near_cut = cKDTree(self.cut).query(self.points)[0] < _NEAR_CUT
        gap, near = self.tree.query(self.points, k=min(_NEIGHBOURS, len(self.points)))
        way = self.points - self.points[near].mean(axis=1)
        way -= np.einsum("ij,ij->i", way, self.normals)[:, None] * self.normals
        return np.asarray(near_cut & (np.linalg.norm(way, axis=1) > _ONE_SIDED * gap[:, -1]))

    @cached_property
    def probes(self) -> tuple[Array, Array]:
        """Some observed points, spread evenly, and their normals, shape (k, 3) each."""
        chosen = farthest_points(self.points, min(_PROBES, len(self.points)))
        return self.points[chosen], self.normals[chosen]

    @cached_property
    def noise_share(self) -> float:
        """Share of the information that is due to errors of normals, per direction.

        Measured: of the observed points at some rigid displacements, the slope of the squared
        distances is what a registration can gain; the normals there promise more. Displaced by more
        than the size of a bump, points know nothing of the bumps.
        """
        points = self.probes[0]
        middle = points.mean(axis=0)
        lever = points - middle
        radius = float(np.sqrt(np.square(lever).sum(axis=1).mean()))
        rng = np.random.default_rng(0)
        missing = total = 0.0
        for y in rng.normal(size=(_DISPLACEMENTS, 6)):
            e = np.concatenate([y[:3] / max(radius, 1e-3), y[3:]])
            way = np.cross(e[:3], lever) + e[3:]
            e *= _DISPLACED / np.sqrt(np.square(way).sum(axis=1).mean())
            both = [lever @ se3.so3_exp(sign * e[:3]).T + sign * e[3:] for sign in (1.0, -1.0)]
            at = np.concatenate(both)
            distance, normals = self.distance(at + middle)
            known = self.tree.query(at + middle, distance_upper_bound=_DISPLACED)[0] < _DISPLACED
            promised = jacobian(at, normals) @ -e
            gained = np.repeat([1.0, -1.0], len(lever)) * promised * distance
            missing += known @ (np.square(promised) - gained)
            total += known.sum() * (np.square(e[:3] * radius).sum() + np.square(e[3:]).sum())
        return max(NOISE_SHARE, missing / max(total, 1e-12))

    def placed(self, R_WO: Array) -> tuple[Array, Array]:
        """The probes from the origin of O, and their normals, in the axes of the world."""
        points, normals = self.probes
        return points @ R_WO.T, normals @ R_WO.T

    def distance(self, x: Array) -> tuple[Array, Array]:
        """Distance of points (n, 3) from the surface (n,) [m] and unit gradients (n, 3).

        One Newton step of the raw distance: right near the surface, where it matters.
        """
        raw, gradient = self.gpdf.distance_and_gradient(x)
        slope = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
        step = raw / np.maximum(slope, _LEAST_SLOPE)
        normals = gradient / np.maximum(slope, 1e-12)[:, None]
        return np.clip(step, -2.5 * np.abs(raw), 2.5 * np.abs(raw)), normals
