"""Error measures of one completed shape; see `feasigrasp_lab.studies.shape`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp_lab.results.statistics import area_under_curve
from feasigrasp_lab.training.data.views import PartialView, ViewedObject

# The completed surface itself, the zero level set of a distance field, as dense samples.
#
# The pipeline works with the 8 x 8 x 8 grid of `Gpdf.surface`; its points are a centimetre apart
# and unevenly spread, too coarse to measure millimetres against. Here a fine grid finds the surface
# by changes of sign, its crossings are spread out on the tangent planes, and all of it is
# projected.


@dataclass(frozen=True, eq=False)
class LevelSet:
    """Samples of a completed surface.

    Attributes:
        points: Shape (m, 3) [m].
        normals: Outward unit normals, shape (m, 3).
        area: Area that each sample stands for, shape (m,) [m^2]; 0 for samples that only make the
            others denser.
        spacing: Typical distance between neighbouring samples [m].
    """

    points: Array
    normals: Array
    area: Array
    spacing: float

    def distance(self, x: Array) -> Array:
        """Distance of points (n, 3) to the surface, (n,) [m]; infinite if there is none.

        A sample stands for a disc of radius ``spacing / 2`` in its tangent plane, so that the gaps
        between samples do not count as error.
        """
        if len(self.points) == 0:
            return np.full(len(x), np.inf)
        # Nearest samples whose tangent discs are tried for a distance.
        near = cKDTree(self.points).query(x, k=min(4, len(self.points)))[1]
        offset = x[:, None] - self.points[near.reshape(len(x), -1)]
        height = np.einsum("nkj,nkj->nk", offset, self.normals[near.reshape(len(x), -1)])
        across = np.sqrt(np.maximum(np.einsum("nkj,nkj->nk", offset, offset) - height**2, 0.0))
        beyond = np.maximum(across - self.spacing / 2, 0.0)
        return np.asarray(np.sqrt(height**2 + beyond**2).min(axis=1))


def sample_level_set(field: Gpdf, seeds: Iterable[Array] = (), cells: int = 40) -> LevelSet:
    """Samples the completed surface of a field.

    Args:
        field: The field. If it has free space, surface in it does not count, see
            `CompletedField.possible`.
        seeds: More points (n, 3) that are projected onto the surface: walls thinner than a cell
            change no sign.
        cells: Cells of the grid along each side of the box that `Gpdf.surface` searches.
    """
    field = replace(field, damped=True)  # the paper's short steps end beside the surface
    lower, upper = field.search_box
    axes = [np.linspace(a, b, cells) for a, b in zip(lower, upper, strict=True)]
    step = (upper - lower) / (cells - 1)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value = field.distance(grid.reshape(-1, 3)).reshape(cells, cells, cells)

    crossings = []
    for axis in range(3):
        low = np.take(value, range(cells - 1), axis)
        high = np.take(value, range(1, cells), axis)
        index = np.argwhere((low < 0.0) != (high < 0.0))
        a, b = low[tuple(index.T)], high[tuple(index.T)]
        start = grid[tuple(index.T)]
        start[:, axis] += step[axis] * a / (a - b)
        crossings.append(start)
    points, normals = _project(field, np.concatenate(crossings))
    # Cauchy-Crofton: a piece of area A with normal n is crossed A sum_k |n_k| / (cell of the
    # lines along k) times.
    per_area = np.abs(normals) @ (step / np.prod(step))
    area = 1.0 / per_area

    spacing = float(np.prod(step) ** (1.0 / 3.0)) / 2.0
    first, second = perpendiculars(normals)
    spread = [points + spacing * side for side in (first, -first, second, -second)]
    more = _project(field, np.concatenate([*spread, *seeds]), steps=4)
    points, normals = np.concatenate([points, more[0]]), np.concatenate([normals, more[1]])
    area = np.concatenate([area, np.zeros(len(more[0]))])
    kept = field.possible(points)
    return LevelSet(points[kept], normals[kept], area[kept], spacing)


def _project(field: Gpdf, x: Array, steps: int = 5) -> tuple[Array, Array]:
    ends, normals = field.refine(x, steps)[1:]
    # A projected point is on the surface if |d| is less [m].
    on = np.abs(field.distance(ends)) < 5e-4
    return ends[on], normals[on]


# Points on the true surface that a shape is judged by.
def true_samples(viewed: ViewedObject, seed: int, count: int = 2000) -> tuple[Array, Array]:
    """Points spread uniformly by area over the true surface and their normals, (count, 3) each."""
    points, faces = trimesh.sample.sample_surface(viewed.obj.mesh, count, seed=seed)
    return np.asarray(points), np.asarray(viewed.obj.mesh.face_normals[faces])


def measure(
    viewed: ViewedObject, field: Gpdf, views: Sequence[PartialView], points: Array, normals: Array
) -> dict[str, float]:
    """Compares a completed shape with the truth.

    Args:
        viewed: The object.
        field: The completed shape, in O.
        views: What it was made from.
        points: Points on the true surface, shape (n, 3) [m].
        normals: Their normals, shape (n, 3).

    Returns:
        By name: distances in mm, angles in degrees, shares in percent. NaN where there is nothing
        to measure (no unseen point, say).
    """
    # Completed points farther from the true surface than this are invented [m].
    invented = 0.01
    in_sight, seen = np.any([viewed.sees(points, normals, view) for view in views], axis=0)
    hidden, judged = ~in_sight, ~in_sight | seen
    surface = sample_level_set(field, (field.points, points))
    distance = 1e3 * surface.distance(points)
    on_surface = replace(field, damped=True).refine(points[seen])[2]
    cosine = np.einsum("ij,ij->i", on_surface, normals[seen])
    used = field.completion.points
    dense_error, used_error = viewed.surface.distance(surface.points), viewed.surface.distance(used)
    weight = surface.area / max(surface.area.sum(), 1e-30)
    return {
        "true_to_completed_mm": float(distance.mean()),
        "seen_mm": _mean(distance[seen]),
        "unseen_mm": _mean(distance[hidden]),
        "unseen_p95_mm": float(np.percentile(distance[hidden], 95)) if hidden.any() else np.nan,
        "normal_seen_deg": float(np.rad2deg(np.arccos(np.clip(np.median(cosine), -1.0, 1.0)))),
        "variance_auc": auc(field.variance(points[judged]), hidden[judged]),
        "variance_auc_in_sight": auc(field.variance(points), hidden),
        "invented_percent": 100.0 * _mean((used_error > invented).astype(float)),
        "invented_area_percent": 100.0 * float(weight @ (dense_error > invented)),
        "completed_to_true_mm": 1e3 * float(weight @ dense_error),
        "completed_points": float(len(used)),
    }


def auc(score: Array, positive: Mask) -> float:
    """`area_under_curve` of a score (n,) that should be larger for positives; NaN without both."""
    if positive.all() or not positive.any():
        return float("nan")
    return area_under_curve(score, positive).value


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
