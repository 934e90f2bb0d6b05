"""``feasigrasp evaluate shape``: compare completed shapes with the true ones.

Every object is looked at from random directions by a noisy depth camera, once and three times
while it turns, and completed by the ``paper`` preset and by the ``default`` one. What each figure
means is written in docs/shape.md. A command that was interrupted goes on after its last object.
"""

from __future__ import annotations

import argparse
import time
import zlib
from collections.abc import Sequence

import numpy as np

from feasigrasp.evaluation.measures.reliability import write_reliability
from feasigrasp.evaluation.measures.shape import measure, true_samples
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.surface_error import surface_deviation
from feasigrasp.results.arguments import add_common_arguments, names, positive, select_objects
from feasigrasp.results.finished import Record, finish_all
from feasigrasp.results.rows import Row, report_rows, write_csv
from feasigrasp.results.statistics import mean
from feasigrasp.training.data.views import PartialView, ViewedObject, fused, turning_views

PRESETS = ("paper", "default")
#: Standard deviation of the tracked pose in the ``3views_tracked`` condition: [m] and [rad].
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
    parser.add_argument("--views", type=positive, default=4, help="first views of every object")


def complete(views: Sequence[PartialView], preset: str) -> Gpdf:
    """Merges views and completes the shape, as perception does."""
    return complete_shape(fused(views, smooth=preset == "default"), preset=preset)


def evaluate_object(name: str, path: str, views: int, seed: int) -> list[Record]:
    """Measures all views, conditions and presets of one object.

    Returns:
        One record each: the figures of `measure`, what they are of, the CPU time of the last
        perception tick [ms] and, for calibration, the predicted deviation and the error of
        completed points.
    """
    viewed = ViewedObject(load_object(path))
    points, normals = true_samples(viewed, seed)
    records = []
    for index in range(views):
        for condition, (count, tracking) in CONDITIONS.items():
            rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
            cameras = turning_views(rng, viewed.center, max(n for n, _ in CONDITIONS.values()))
            seen = [viewed.view(X_OC, rng, tracking) for X_OC in cameras[:count]]
            for preset in PRESETS:
                start = time.process_time()
                field = complete(seen, preset)
                surface = field.completion
                cpu = 1e3 * (time.process_time() - start) / count
                record: Record = {"object": name, "view": index, "condition": condition}
                record |= {"preset": preset, "cpu_ms": cpu}
                record |= measure(viewed, field, seen, points, normals)
                record["deviation"] = surface_deviation(field, surface.points).round(6).tolist()
                record["error"] = viewed.surface.distance(surface.points).round(6).tolist()
                records.append(record)
    return records


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
    rows = summary_rows(records)
    rows += write_reliability(records, set(builtin_objects()), args.out)
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
        for condition, column, unit, name in FIGURES:
            for preset in PRESETS:
                values = [
                    r[column]
                    for r in members
                    if (r["condition"], r["preset"]) == (condition, preset)
                    and r[column] is not None
                ]
                if values:
                    rows.append(Row.of(name, preset + group, mean(values, lower=0.0), unit))
    return rows
