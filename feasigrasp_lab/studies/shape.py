"""``feasigrasp evaluate shape``: compare completed shapes with the true ones.

Every object is looked at from random directions by a noisy depth camera, once and three times
while it turns, and completed by the ``paper`` preset and by the ``default`` one.
``docs/results_schema.md`` defines each figure. A command that was interrupted goes on after its
last object.
"""

import argparse
import itertools
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry.se3 import perpendiculars
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.models.shape.completion import DEFAULT, complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import add_common_arguments, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import area_under_curve, grouped, mean
from feasigrasp_lab.training.data.views import PartialView, ViewedObject, fused, turning_views

PRESETS = ("paper", "default")
#: Number of views by condition.
CONDITIONS = {"1view": 1, "3views": 3}
#: Figures of the summary: condition, column, unit and row name.
FIGURES = (
    ("1view", "true_to_completed_mm", "mm", "shape.true_to_completed_mm.1view"),
    ("1view", "unseen_mm", "mm", "shape.unseen_mm.1view"),
    ("3views", "true_to_completed_mm", "mm", "shape.true_to_completed_mm.3views"),
    ("1view", "variance_auc", "1", "shape.variance_auc"),
    ("1view", "invented_percent", "%", "shape.invented_percent.1view"),
    ("3views", "invented_percent", "%", "shape.invented_percent.3views"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_shape", objects="builtin")
    parser.add_argument(
        "--views", type=positive, default=4, help="Number of first views of every object."
    )


def evaluate_object(name: str, path: str, views: int, seed: int) -> list[Record]:
    """Measures all views, conditions and presets of one object.

    Returns:
        One record each: the figures of `measure`, and what they are of.
    """
    viewed = ViewedObject(load_object(path))
    points, normals = true_samples(viewed, seed)
    records = []
    for index in range(views):
        for condition, count in CONDITIONS.items():
            rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
            cameras = turning_views(rng, viewed.center, max(CONDITIONS.values()))
            seen = [viewed.view(X_OC, rng) for X_OC in cameras[:count]]
            for preset in PRESETS:
                field = complete_shape(fused(seen, smooth=preset == DEFAULT), preset=preset)
                record: Record = {"object": name, "view": index, "condition": condition}
                figures = measure(viewed, field, seen, points, normals)
                records.append(record | {"preset": preset} | figures)
    return records


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
        spacing: Typical distance between neighbouring samples [m].
    """

    points: Array
    normals: Array
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


def sample_level_set(field: Gpdf, seeds: Iterable[Array] = ()) -> LevelSet:
    """Samples the completed surface of a field.

    Args:
        field: The field. If it has free space, surface in it does not count, see
            `CompletedField.possible`.
        seeds: More points (n, 3) that are projected onto the surface: walls thinner than a cell
            change no sign.
    """
    # Cells of the grid along each side of the box that `Gpdf.surface` searches.
    cells = 40
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
    spacing = float(np.prod(step) ** (1.0 / 3.0)) / 2.0
    first, second = perpendiculars(normals)
    spread = [points + spacing * side for side in (first, -first, second, -second)]
    more = _project(field, np.concatenate([*spread, *seeds]), steps=4)
    points, normals = np.concatenate([points, more[0]]), np.concatenate([normals, more[1]])
    kept = field.possible(points)
    return LevelSet(points[kept], normals[kept], spacing)


def _project(field: Gpdf, x: Array, steps: int = 5) -> tuple[Array, Array]:
    ends, normals = field.refine(x, steps)[1:]
    # A projected point is on the surface if |d| is less [m].
    on = np.abs(field.distance(ends)) < 5e-4
    return ends[on], normals[on]


def true_samples(viewed: ViewedObject, seed: int) -> tuple[Array, Array]:
    """Points spread uniformly by area over the true surface and their normals, (2000, 3) each."""
    points, faces = trimesh.sample.sample_surface(viewed.obj.mesh, 2000, seed=seed)
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
        By name: distances in mm, shares in percent. NaN where there is nothing to measure (no
        unseen point, say).
    """
    # Completed points farther from the true surface than this are invented [m].
    invented = 0.01
    in_sight, seen = np.any([viewed.sees(points, normals, view) for view in views], axis=0)
    hidden, judged = ~in_sight, ~in_sight | seen
    surface = sample_level_set(field, (field.points, points))
    distance = 1e3 * surface.distance(points)
    used_error = viewed.surface.distance(field.completion.points)
    return {
        "true_to_completed_mm": float(distance.mean()),
        "unseen_mm": _mean(distance[hidden]),
        "variance_auc": auc(field.variance(points[judged]), hidden[judged]),
        "invented_percent": 100.0 * _mean((used_error > invented).astype(float)),
    }


def auc(score: Array, positive: Mask) -> float:
    """`area_under_curve` of a score (n,) that should be larger for positives; NaN without both."""
    if positive.all() or not positive.any():
        return float("nan")
    return area_under_curve(score, positive).value


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = select_objects(args.objects)
    views = args.views
    if args.quick:
        objects, views = dict(list(objects.items())[:: -(-len(objects) // 12)]), min(views, 2)
    settings = {"views": views, "seed": args.seed}
    records = finish_all(
        objects, args.out / "objects", settings, evaluate_object, jobs=args.jobs, desc="shape"
    )
    write_csv(args.out / "views.csv", records, floats=".6g")
    report_rows(args, "evaluate shape", summary_rows(records))
    return 0


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Means over all views, and over those of the built-in and of the other objects."""
    built_in = set(builtin_objects())
    groups = {"": records}
    inside = [r for r in records if r["object"] in built_in]
    outside = [r for r in records if r["object"] not in built_in]
    if inside and outside:
        groups |= {"/builtin": inside, "/others": outside}
    rows = []
    for group, members in groups.items():
        found = grouped(members, itemgetter("condition", "preset"))
        for (condition, column, unit, name), preset in itertools.product(FIGURES, PRESETS):
            measured = [r[column] for r in found[condition, preset] if r[column] is not None]
            if measured:
                rows.append(Row.of(name, preset + group, mean(measured, lower=0.0), unit))
    return rows
