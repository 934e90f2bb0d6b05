"""``feasigrasp evaluate length-scale``: repeat the paper's search for the best length scale.

Repeats the grid search of Choi & Figueroa (arXiv 2311.02576), l in (0, 0.6] m, on our objects: one
noisy view of each, completed with every l, compared with the true surface. Beside the paper's
field stands the default one, which also knows which side is inside and where the camera saw past.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from zlib import crc32

import numpy as np
from matplotlib.figure import Figure

from feasigrasp.evaluation.measures.shape import measure, true_samples
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf_fit import Gpdf
from feasigrasp.results import statistics
from feasigrasp.results.arguments import add_common_arguments, positive, select_objects
from feasigrasp.results.finished import Record, finish_all
from feasigrasp.results.rows import Row, report_rows, write_csv
from feasigrasp.training.data.views import PartialView, ViewedObject, fused, turning_views

#: Length scales of the study [m].
LENGTH_SCALES = (0.02, 0.04, 0.07, 0.1, 0.15, 0.2, 0.25, 0.3, 0.36, 0.42, 0.48, 0.54, 0.6)
QUICK_LENGTH_SCALES = (0.03, 0.1, 0.3, 0.6)
PRESETS = ("paper", "default")
#: What is compared, and how the picture calls it.
MEASURES = {
    "true_to_completed_mm": "whole object",
    "seen_mm": "seen side",
    "unseen_mm": "unseen side",
}
#: Points that the fields are fitted to.
_POINTS = 512
#: Points on the true surface that a completion is compared with.
_SAMPLES = 1000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command."""
    add_common_arguments(parser, out="out/length_scale", objects="builtin")
    parser.add_argument("--views", type=positive, default=4, help="views per object, one at a time")


def fit_view(preset: str, view: PartialView, length_scale: float) -> Gpdf:
    """The field that a preset makes of one view with a length scale [m].

    Without the network of the hidden side, which was trained for one length scale.
    """
    return complete_shape(
        fused([view], smooth=preset == "default"),
        preset=preset,
        length_scale=length_scale,
        max_points=_POINTS,
        learnt=False,
    )


def study_object(
    name: str, model: str, length_scales: Sequence[float], views: int, seed: int
) -> list[Record]:
    """Completes one object from several views, each alone, with every preset and length scale."""
    viewed = ViewedObject(load_object(model))
    records = []
    for index in range(views):
        rng = np.random.default_rng([seed, crc32(name.encode()), index])
        (X_OC,) = turning_views(rng, np.zeros(3), 1)
        view = viewed.view(X_OC, rng)
        points, normals = true_samples(viewed, seed, _SAMPLES)
        for preset in PRESETS:
            for length_scale in length_scales:
                field = fit_view(preset, view, length_scale)
                found = measure(viewed, field, [view], points, normals)
                records.append(
                    {"object": name, "view": index, "preset": preset, "length_scale": length_scale}
                    | {key: found[key] for key in MEASURES}
                )
    return records


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = select_objects(args.objects)
    length_scales: Sequence[float] = LENGTH_SCALES
    views = args.views
    if args.quick:
        objects, length_scales, views = (
            dict(list(objects.items())[::3]),
            QUICK_LENGTH_SCALES,
            1,
        )
    settings = {"length_scales": length_scales, "views": views, "seed": args.seed}
    finished = finish_all(
        objects, args.out / "objects", settings, study_object, jobs=args.jobs, desc="length scale"
    )
    records = [record for found in finished.values() for record in found]
    records.sort(key=lambda r: (r["object"], r["view"], r["preset"], r["length_scale"]))
    rows = summary_rows(records)
    write_csv(args.out / "views.csv", records)
    write_csv(
        args.out / "curve.csv",
        [
            (*key, length_scale, row.value, row.low, row.high, row.n)
            for key, points in curves(rows).items()
            for length_scale, row in points
        ],
        ("measure", "preset", "length_scale_m", "mean_mm", "low", "high", "n"),
    )
    draw_curve(rows, args.out / "curve.png")
    report_rows(args, "evaluate length-scale", rows, format_table(rows))
    return 0


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Means over objects and views; the interval is that of the objects' means.

    The views of one object resemble each other, so the objects are the independent repeats.
    """
    rows = []
    keys = sorted({(r["preset"], r["length_scale"]) for r in records})
    for preset, length_scale in keys:
        chosen = [r for r in records if (r["preset"], r["length_scale"]) == (preset, length_scale)]
        for measured in MEASURES:
            by_object: dict[str, list[float]] = {}
            for r in chosen:  # what could not be measured (nothing unseen, say) is None
                if r[measured] is not None:
                    by_object.setdefault(r["object"], []).append(r[measured])
            per_object = [float(np.mean(by_object[name])) for name in sorted(by_object)]
            rows.append(
                Row.of(
                    f"length_scale.{measured}",
                    f"{preset}/{length_scale:g}",
                    statistics.mean(per_object, lower=0.0),
                    "mm",
                )
            )
    return rows


def curves(rows: Sequence[Row]) -> dict[tuple[str, str], list[tuple[float, Row]]]:
    """By measure and preset, the length scales [m] with their rows, in order."""
    found: dict[tuple[str, str], list[tuple[float, Row]]] = {}
    for row in rows:
        preset, length_scale = row.preset.split("/")
        measured = row.name.removeprefix("length_scale.")
        found.setdefault((measured, preset), []).append((float(length_scale), row))
    return {key: sorted(points, key=lambda point: point[0]) for key, points in found.items()}


def draw_curve(rows: Sequence[Row], filename: Path) -> None:
    """Draws error over length scale, one panel per measure, with 95 % intervals."""
    figure = Figure(figsize=(9.5, 3.2), layout="constrained")
    axes = dict(zip(MEASURES, figure.subplots(1, len(MEASURES)), strict=True))
    colors = {"paper": "#c2571a", "default": "#1f5fa8"}
    for (measured, preset), points in curves(rows).items():
        ax, x = axes[measured], [length_scale for length_scale, _ in points]
        ax.plot(x, [row.value for _, row in points], "o-", ms=3, color=colors[preset], label=preset)
        band = [(x, row.low, row.high) for x, row in points if row.low is not None]
        if band:
            ax.fill_between(*zip(*band, strict=True), color=colors[preset], alpha=0.15, lw=0)
    for measured, ax in axes.items():
        ax.set_title(MEASURES[measured], fontsize=10)
        ax.set_xlabel("length scale l [m]")
        ax.set_ylim(bottom=0.0)
        ax.axvline(0.3, color="0.6", ls=":", lw=1)
        ax.grid(alpha=0.25)
    next(iter(axes.values())).set_ylabel("distance true → completed [mm]")
    next(iter(axes.values())).legend(frameon=False)
    figure.savefig(filename, dpi=110)


def format_table(rows: Sequence[Row]) -> str:
    """Mean errors, a line per length scale."""
    found = curves(rows)
    heads = [(measured, preset) for measured in MEASURES for preset in PRESETS]
    first = "".join(f"{MEASURES[measured]:>13s}" for measured, _ in heads)
    lines = [f"mm{first}", "l [m]" + "".join(f"{preset:>13s}" for _, preset in heads)[3:]]
    for index, (length_scale, _) in enumerate(found[heads[0]]):
        values = "".join(f"{found[head][index][1].value:13.2f}" for head in heads)
        lines.append(f"{length_scale:<5.2f}{values[3:]}")
    return "\n".join(lines)
