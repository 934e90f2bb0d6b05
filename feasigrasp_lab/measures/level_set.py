"""The completed surface itself, the zero level set of a distance field, as dense samples.

The pipeline works with the 8 x 8 x 8 grid of `Gpdf.surface`; its points are a centimetre apart and
unevenly spread, too coarse to measure millimetres against. Here a fine grid finds the surface by
changes of sign, its crossings are spread out on the tangent planes, and all of it is projected.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.shape.gpdf import Gpdf

#: A projected point is on the surface if |d| is less [m].
_ON_SURFACE = 5e-4
#: Nearest samples whose tangent discs are tried for a distance.
_NEIGHBOURS = 4


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
        near = cKDTree(self.points).query(x, k=min(_NEIGHBOURS, len(self.points)))[1]
        offset = x[:, None] - self.points[near.reshape(len(x), -1)]
        height = np.einsum("nkj,nkj->nk", offset, self.normals[near.reshape(len(x), -1)])
        across = np.sqrt(np.maximum(np.einsum("nkj,nkj->nk", offset, offset) - height**2, 0.0))
        beyond = np.maximum(across - self.spacing / 2, 0.0)
        return np.asarray(np.sqrt(height**2 + beyond**2).min(axis=1))


def sample_level_set(field: Gpdf, seeds: Iterable[Array] = (), cells: int = 40) -> LevelSet:
    """Samples the completed surface of a field.

    Args:
        field: The field. If it knows free space, surface in it does not count, see
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
    on = np.abs(field.distance(ends)) < _ON_SURFACE
    return ends[on], normals[on]
