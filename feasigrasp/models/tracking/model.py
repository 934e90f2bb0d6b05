"""Shape model of a tracker: distance field, observed part, information of a registered pose."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.points import farthest_points
from feasigrasp.models.shape.gpdf import Gpdf

# Information matrix of a registered pose, without the share that is noise.
#
# The rows of a registration are ``J = -[r x n, n]``: point r from the origin of O, normal n. Along
# a direction that the shape does not determine, such as the turn of a can, an ideal surface has ``J
# e = 0``; one that is known from noisy points has bumps, and a registration would take them for
# information and follow them. Normals that err by the angle ``a`` give about ``a^2`` of the
# information that normals in all directions would give. So that share is taken off every
# eigenvalue, and what falls below zero is cut: there the estimate stays at its prior. Of an
# eigenvalue ``h`` of which ``b`` is left, a gradient says that the error is ``g / b``, with the
# variance ``h / b^2``: the information is ``b^2 / h``. (On regressors that err: Fuller, Measurement
# Error Models, 1987.)

#: Share of the whole information that wrong normals alone bring, in every direction, at least.
#: Source: guessed.
NOISE_SHARE = 0.003


def jacobian(lever: Array, normals: Array) -> Array:
    """Change of the distances of fixed points from a body by its error [theta, p], shape (n, 6).

    The points (n, 3) [m] are given from the origin of O, they and the gradients of the distance
    there (n, 3) in the axes of the world.
    """
    (x, y, z), (a, b, c) = lever.T, normals.T
    # -(lever x normal), written out: np.cross is slower than all the rest.
    return np.stack([z * b - y * c, x * c - z * a, y * a - x * b, -a, -b, -c], axis=1)


def without_noise(J: Array, weights: Array, lever: Array, noise: float) -> tuple[Array, Array]:
    """The information of weighted rows, less what noise alone would bring.

    Of rows (n, 6) of `jacobian`, at levers (n, 3) [m], with inverse variances (n,), by the share of
    noise, see `TrackedModel.noise_share`.

    Returns:
        The information (6, 6), and the projection (6, 6) that takes a gradient ``J^T w r`` to that
        part of it which is retained.
    """
    total = float(weights.sum())
    if total <= 0.0:
        return np.zeros((6, 6)), np.zeros((6, 6))
    middle = weights @ lever / total
    radius = float(np.sqrt(weights @ np.square(lever - middle).sum(axis=1) / total))
    # About the center of the visible points, in units that a turn moves points as far as a shift
    # does: theta and p there, e = T y.
    T = np.eye(6)
    T[:3, :3] /= max(radius, 1e-3)
    T[3:, :3] = se3.hat(middle) @ T[:3, :3]
    rows = J @ T
    values, vectors = np.linalg.eigh(rows.T @ (weights[:, None] * rows))
    retained = np.maximum(values - noise * total, 0.0)
    share = np.divide(retained, values, out=np.zeros(6), where=values > 0.0)
    T_inverse = np.linalg.inv(T)
    information = T_inverse.T @ (vectors * (retained * share)) @ vectors.T @ T_inverse
    projection = T_inverse.T @ (vectors * share) @ vectors.T @ T.T
    return information, projection


def surface_deviation(covariance: Array, lever: Array, normals: Array) -> float:
    """Root mean square distance between measured and expected surface, along the normals [m].

    What the shape does not determine does not count: a can may turn, and is where it was. By the
    covariance (6, 6) of [theta, p]; the surface is given as in `jacobian`.
    """
    rows = jacobian(lever, normals)
    return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", rows, covariance, rows))))


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
        # Neighbours of an observed point that decide whether the surface goes on around it, and how
        # far off their middle is at an edge, in units of their distance.
        neighbours, one_sided = 16, 0.25
        if len(self.cut) == 0:
            return np.zeros(len(self.points), dtype=bool)
        # Such an edge is that of an image, and not of the object, near to where one ended [m].
        near_cut = cKDTree(self.cut).query(self.points)[0] < 0.01
        gap, near = self.tree.query(self.points, k=min(neighbours, len(self.points)))
        way = self.points - self.points[near].mean(axis=1)
        way -= np.einsum("ij,ij->i", way, self.normals)[:, None] * self.normals
        return np.asarray(near_cut & (np.linalg.norm(way, axis=1) > one_sided * gap[:, -1]))

    @cached_property
    def probes(self) -> tuple[Array, Array]:
        """Some observed points, spread evenly, and their normals, shape (k, 3) each."""
        # Points of the model that are looked for in an image.
        chosen = farthest_points(self.points, min(300, len(self.points)))
        return self.points[chosen], self.normals[chosen]

    @cached_property
    def noise_share(self) -> float:
        """Share of the information that is due to errors of normals, per direction.

        Measured: of the observed points at some rigid displacements, the slope of the squared
        distances is what a registration can gain; the normals there promise more. Displaced by more
        than the size of a bump, points know nothing of the bumps.
        """
        # Rigid displacements for the error of the normals, and how far they move the points [m].
        displacements, displaced = 4, 4e-3
        points = self.probes[0]
        middle = points.mean(axis=0)
        lever = points - middle
        radius = float(np.sqrt(np.square(lever).sum(axis=1).mean()))
        rng = np.random.default_rng(0)
        missing = total = 0.0
        for y in rng.normal(size=(displacements, 6)):
            e = np.concatenate([y[:3] / max(radius, 1e-3), y[3:]])
            way = np.cross(e[:3], lever) + e[3:]
            e *= displaced / np.sqrt(np.square(way).sum(axis=1).mean())
            both = [lever @ se3.so3_exp(sign * e[:3]).T + sign * e[3:] for sign in (1.0, -1.0)]
            at = np.concatenate(both)
            distance, normals = self.distance(at + middle)
            known = self.tree.query(at + middle, distance_upper_bound=displaced)[0] < displaced
            promised = jacobian(at, normals) @ -e
            gained = np.repeat([1.0, -1.0], len(lever)) * promised * distance
            missing += known @ (np.square(promised) - gained)
            total += known.sum() * (np.square(e[:3] * radius).sum() + np.square(e[3:]).sum())
        return max(NOISE_SHARE, missing / max(total, 1e-12))

    def placed(self, R_WO: Array) -> tuple[Array, Array]:
        """The probes from the origin of O, and their normals, in the axes of the world."""
        return self.probes[0] @ R_WO.T, self.probes[1] @ R_WO.T

    def distance(self, x: Array) -> tuple[Array, Array]:
        """Distance of points (n, 3) from the surface (n,) [m] and unit gradients (n, 3).

        One Newton step of the raw distance: right near the surface, where it matters.
        """
        raw, gradient = self.gpdf.distance_and_gradient(x)
        slope = np.sqrt(np.einsum("ij,ij->i", gradient, gradient))
        # Slopes of the raw distance below this are no slopes, as in the field's own Newton step.
        step = raw / np.maximum(slope, 0.2)
        normals = gradient / np.maximum(slope, 1e-12)[:, None]
        return np.clip(step, -2.5 * np.abs(raw), 2.5 * np.abs(raw)), normals
