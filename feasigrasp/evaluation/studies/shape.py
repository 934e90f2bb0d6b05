"""``feasigrasp evaluate shape``: completed shapes against the true ones.

Every object is looked at from random directions by a noisy depth camera, once and three times
while it turns, and completed by the ``paper`` preset and by the ``default`` one. What each figure
means is written in docs/shape.md. A command that was interrupted goes on after its last object.
"""

from __future__ import annotations

import argparse
import shlex
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm

from feasigrasp.evaluation.measures.reliability import write_reliability
from feasigrasp.evaluation.measures.shape import measure, true_samples
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.objects.rigid_object import builtin_objects, load_object
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.shape.surface_error import surface_deviation
from feasigrasp.results.arguments import add_common_arguments, names, positive, select_objects
from feasigrasp.results.finished import finished_records
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.row_table import format_rows
from feasigrasp.results.rows import Row, write_json, write_summary
from feasigrasp.results.statistics import mean
from feasigrasp.training.data.views import PartialView, ViewedObject, turning_views

Record = dict[str, Any]

PRESETS = ("paper", "default")
#: Standard deviation of the tracked pose in the ``3views_tracked`` condition: [m] and [rad].
TRACKING = (0.002, float(np.deg2rad(1.0)))
#: What is looked at how: number of views and tracking noise.
CONDITIONS = {"1view": (1, (0.0, 0.0)), "3views": (3, (0.0, 0.0)), "3views_tracked": (3, TRACKING)}
#: Voxels in which views are merged, as in the scenarios [m].
VOXEL_SIZE = 0.003
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
    cloud = FusedCloud.empty(VOXEL_SIZE, smooth=preset == "default")
    for view in views:
        cloud = cloud.merged(view.points, view.p_OC)
    return complete_shape(cloud, preset=preset)


def evaluate_object(name: str, path: str, views: int, seed: int) -> list[Record]:
    """Measures all views, conditions and presets of one object.

    Returns:
        One record each: the figures of `measure`, what they are of, the CPU time of the last
        perception tick [ms] and, for calibration, the predicted deviation and the error of
        completed points.
    """
    viewed = ViewedObject(load_object(path))
    points, normals = true_samples(viewed, seed)
    center = 0.5 * (viewed.obj.vertices.min(axis=0) + viewed.obj.vertices.max(axis=0))
    records = []
    for index in range(views):
        for condition, (count, tracking) in CONDITIONS.items():
            rng = np.random.default_rng([seed, zlib.crc32(name.encode()), index])
            cameras = turning_views(rng, center, max(n for n, _ in CONDITIONS.values()))
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
                record["error"] = viewed.distance(surface.points).round(6).tolist()
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
    key = {"git": git_revision(), "versions": versions(), "views": views, "seed": args.seed}
    folder = args.out / "objects"
    missing = [name for name in objects if finished_records(folder / f"{name}.json", key) is None]
    evaluated = joblib.Parallel(n_jobs=args.jobs, return_as="generator_unordered")(
        joblib.delayed(_evaluate_to_file)(name, objects[name], folder, key) for name in missing
    )
    bar = tqdm(total=len(objects), initial=len(objects) - len(missing), desc="shape", unit="object")
    with bar:
        for _ in evaluated:
            bar.update()
    records = []
    for name in objects:
        records += finished_records(folder / f"{name}.json", key) or []

    write_csv(records, args.out / "views.csv")
    rows = summary_rows(records)
    rows += write_reliability(records, set(builtin_objects()), args.out)
    filename = args.out / "summary.json"
    write_summary(filename, _command(args), key["git"], args.seed, rows, quick=args.quick)
    print(format_rows(rows))
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


def write_csv(records: Sequence[Record], filename: Path) -> None:
    """One line per view, condition and preset."""
    columns = [name for name, value in records[0].items() if not isinstance(value, list)]
    lines = [",".join(columns)]
    for record in records:
        values = (record[column] for column in columns)
        lines.append(",".join(_cell(value) for value in values))
    filename.parent.mkdir(parents=True, exist_ok=True)
    filename.write_text("\n".join(lines) + "\n")


def _command(args: argparse.Namespace) -> str:
    options = ("out", "seed", "jobs", "objects", "views")
    words = [word for name in options for word in (f"--{name}", str(getattr(args, name)))]
    words += ["--quick"] * args.quick
    return shlex.join(["feasigrasp", "evaluate", "shape", *words])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _evaluate_to_file(name: str, path: str, folder: Path, key: dict[str, Any]) -> None:
    records = evaluate_object(name, path, key["views"], key["seed"])
    for record in records:  # JSON has no NaN
        for column, value in record.items():
            if isinstance(value, float) and not np.isfinite(value):
                record[column] = None
    write_json({"key": key, "records": records}, folder / f"{name}.json")
