"""``feasigrasp evaluate shape``: compare completed shapes with the true ones.

Every object is looked at from random directions by a noisy depth camera, once and three times
while it turns, and completed by the ``paper`` preset and by the ``default`` one.
``docs/results_schema.md`` defines each figure. A command that was interrupted goes on after its
last object.
"""

from __future__ import annotations

import argparse
import itertools
import zlib
from collections.abc import Sequence
from functools import cache, partial
from operator import itemgetter
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from feasigrasp.models.arrays import Array
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.models.shape.completion import DEFAULT, complete_shape
from feasigrasp.models.shape.gpdf import Gpdf, surface_deviation
from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.measures.shape import measure, true_samples
from feasigrasp_lab.measures.timing import cpu_ms
from feasigrasp_lab.results.arguments import add_common_arguments, names, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped, mean
from feasigrasp_lab.training.data.views import PartialView, ViewedObject, fused, turning_views

PRESETS = ("paper", "default")
#: Standard deviation of the tracked pose in the ``3views_tracked`` condition: [m] and [rad].
#: Source: definition.
TRACKING = (0.002, float(np.deg2rad(1.0)))
#: What is looked at how: number of views and tracking noise.
CONDITIONS = {"1view": (1, (0.0, 0.0)), "3views": (3, (0.0, 0.0)), "3views_tracked": (3, TRACKING)}
#: Figures of the summary, by condition: column, unit and row name.
FIGURES = (
    ("1view", "true_to_completed_mm", "mm", "shape.true_to_completed_mm.1view"),
    ("1view", "unseen_mm", "mm", "shape.unseen_mm.1view"),
    ("3views", "true_to_completed_mm", "mm", "shape.true_to_completed_mm.3views"),
    ("1view", "normal_seen_deg", "deg", "shape.normal_seen_deg"),
    ("1view", "variance_auc", "1", "shape.variance_auc"),
    ("1view", "invented_percent", "%", "shape.invented_percent.1view"),
    # Beyond the bars.
    ("1view", "variance_auc_in_sight", "1", "shape.variance_auc_in_sight"),
    ("1view", "seen_mm", "mm", "shape.seen_mm.1view"),
    ("1view", "completed_to_true_mm", "mm", "shape.completed_to_true_mm.1view"),
    ("1view", "invented_area_percent", "%", "shape.invented_area_percent.1view"),
    ("3views", "invented_percent", "%", "shape.invented_percent.3views"),
    ("3views_tracked", "true_to_completed_mm", "mm", "shape.true_to_completed_mm.3views_tracked"),
    ("3views_tracked", "invented_percent", "%", "shape.invented_percent.3views_tracked"),
    ("1view", "cpu_ms", "ms", "shape.cpu_ms.1view"),
    ("3views", "cpu_ms", "ms", "shape.cpu_ms.3views"),
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
        One record each: the figures of `measure`, what they are of, the processor time of a view
        [ms] and, for calibration, the predicted deviation and the error of completed points.
    """
    _warm_up()
    viewed = ViewedObject(load_object(path))
    points, normals = true_samples(viewed, seed)
    records = []
    for index in range(views):
        for condition, (count, tracking) in CONDITIONS.items():
            rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
            cameras = turning_views(rng, viewed.center, max(n for n, _ in CONDITIONS.values()))
            seen = [viewed.view(X_OC, rng, tracking) for X_OC in cameras[:count]]
            for preset in PRESETS:
                field, cpu = cpu_ms(partial(_completed, seen, preset))
                surface = field.completion
                record: Record = {"object": name, "view": index, "condition": condition}
                record |= {"preset": preset, "cpu_ms": cpu / count}
                record |= measure(viewed, field, seen, points, normals)
                record["deviation"] = surface_deviation(field, surface.points).round(6).tolist()
                record["error"] = viewed.surface.distance(surface.points).round(6).tolist()
                records.append(record)
    return records


def _completed(seen: Sequence[PartialView], preset: str) -> Gpdf:
    """The field of some views, with its completed surface."""
    field = complete_shape(fused(seen, smooth=preset == DEFAULT), preset=preset)
    _ = field.completion
    return field


@cache
def _warm_up() -> None:
    """Loads compiled code and weights, which would count as time of the process's first view."""
    viewed, rng = ViewedObject(load_object("ball")), np.random.default_rng(0)
    seen = [viewed.view(X_OC, rng) for X_OC in turning_views(rng, viewed.center, 2)]
    for preset in PRESETS:
        _completed(seen, preset)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects: dict[str, str] = {}
    for part in names(args.objects):
        objects |= select_objects(part)
    views = args.views
    if args.quick:
        objects, views = dict(list(objects.items())[:: -(-len(objects) // 12)]), min(views, 2)
    settings = {"views": views, "seed": args.seed}
    finished = finish_all(
        objects, args.out / "objects", settings, evaluate_object, jobs=args.jobs, desc="shape"
    )
    records = [record for name in objects for record in finished[name]]
    columns = [name for name, value in records[0].items() if not isinstance(value, list)]
    write_csv(args.out / "views.csv", records, columns, ".6g")
    rows = summary_rows(records) + write_reliability(records, args.out)
    report_rows(args, "evaluate shape", rows)
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


def write_reliability(records: Sequence[Record], folder: Path) -> list[Row]:
    """Does the field know what it does not know? Predicted deviation against actual error.

    Writes ``reliability.csv`` and ``reliability.png`` of one-view completions.

    Returns:
        For the built-in objects, on which the prediction was calibrated, and for others, the mean
        difference between predicted deviation and mean error of the bins.
    """
    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    rows, lines, top, built_in = [], [], 0.0, set(builtin_objects())
    one_view = [r for r in records if (r["condition"], r["preset"]) == ("1view", "default")]
    for label, group in (("calibrated on", "builtin"), ("held out", "others")):
        chosen = [r for r in one_view if (r["object"] in built_in) == (group == "builtin")]
        if not chosen:
            continue
        error = 1e3 * np.concatenate([r["error"] for r in chosen])
        table = _binned(1e3 * np.concatenate([r["deviation"] for r in chosen]), error)
        lines += [(label, *figures, int(n)) for *figures, n in table.tolist()]
        axes.plot(table[:, 0], table[:, 1], "o-", label=f"mean error, objects {label}")
        axes.plot(table[:, 0], table[:, 2], ":", color=axes.lines[-1].get_color(), label="90 %")
        top = max(top, table[:, :2].max())
        gap = float(np.abs(table[:, 0] - table[:, 1]).mean())
        name = "shape.calibration_error_mm"
        rows.append(Row.plain(name, f"default/{group}", gap, "mm", len(error)))
    axes.plot([0, top], [0, top], color="0.6", lw=1, label="perfect")
    axes.set(xlabel="predicted deviation [mm]", ylabel="distance to the true surface [mm]")
    axes.legend(fontsize=8)
    save_figure(figure, folder / "reliability.png", dpi=150)
    heads = ("group", "predicted_mm", "mean_error_mm", "p90_error_mm", "points")
    write_csv(folder / "reliability.csv", lines, heads, ".3f")
    return rows


def _binned(predicted: Array, error: Array) -> Array:
    """Mean prediction, mean and 90 % quantile of the error, and count of each bin, (b, 4)."""
    # Groups of equally many completed points, by predicted deviation.
    parts = [part for part in np.array_split(np.argsort(predicted), 12) if len(part)]
    return np.array(
        [[predicted[p].mean(), error[p].mean(), np.quantile(error[p], 0.9), len(p)] for p in parts]
    )
