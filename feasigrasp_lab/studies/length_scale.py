"""``feasigrasp evaluate length-scale``: repeat the paper's search for the best length scale.

Repeats the grid search of Choi & Figueroa (arXiv 2311.02576), l in (0, 0.6] m, on our objects: one
noisy view of each, completed with every l, compared with the true surface. Beside the paper's
field stands the default one, which also has the inside and where the camera saw past.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from zlib import crc32

import numpy as np
from matplotlib.figure import Figure

from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.completion import Preset, complete_shape
from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.arguments import add_common_arguments, positive, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp.runs.results.statistics import grouped, mean
from feasigrasp_lab.measures.shape import measure, true_samples
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.training.data.views import ViewedObject, fused, turning_views

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
    parser.add_argument(
        "--views", type=positive, default=4, help="Number of single views per object."
    )


def study_object(
    name: str, model: str, length_scales: Sequence[float], views: int, seed: int
) -> list[Record]:
    """Completes one object from several views, each alone, with every preset and length scale."""
    viewed = ViewedObject(load_object(model))
    points, normals = true_samples(viewed, seed, _SAMPLES)
    records = []
    for index in range(views):
        rng = np.random.default_rng([seed, crc32(name.encode()), index])
        (X_OC,) = turning_views(rng, np.zeros(3), 1)
        view = viewed.view(X_OC, rng)
        for preset in PRESETS:
            cloud = fused([view], smooth=preset == Preset.DEFAULT)
            for length_scale in length_scales:
                # The network of the hidden side was trained for one length scale: without it.
                about: Record = {"preset": preset, "length_scale": length_scale}
                field = complete_shape(cloud, **about, max_points=_POINTS, learnt=False)
                found = measure(viewed, field, [view], points, normals)
                measured = {key: found[key] for key in MEASURES}
                records.append({"object": name, "view": index} | about | measured)
    return records


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = select_objects(args.objects)
    settings = {"length_scales": LENGTH_SCALES, "views": args.views, "seed": args.seed}
    if args.quick:
        objects = dict(list(objects.items())[::3])
        settings |= {"length_scales": QUICK_LENGTH_SCALES, "views": 1}
    finished = finish_all(
        objects, args.out / "objects", settings, study_object, jobs=args.jobs, desc="length scale"
    )
    records = [record for found in finished.values() for record in found]
    records.sort(key=itemgetter("object", "view", "preset", "length_scale"))
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
    for (preset, scale), chosen in sorted(
        grouped(records, itemgetter("preset", "length_scale")).items()
    ):
        for measured in MEASURES:
            # What could not be measured (nothing unseen, say) is None.
            present = [r for r in chosen if r[measured] is not None]
            by_object = sorted(grouped(present, itemgetter("object")).items())
            means = [np.mean([r[measured] for r in group]) for _, group in by_object]
            name, estimate = f"length_scale.{measured}", mean(means, lower=0.0)
            rows.append(Row.of(name, f"{preset}/{scale:g}", estimate, "mm"))
    return rows


def curves(rows: Sequence[Row]) -> dict[tuple[str, str], list[tuple[float, Row]]]:
    """By measure and preset, the length scales [m] with their rows, in order."""
    found: dict[tuple[str, str], list[tuple[float, Row]]] = {}
    for row in rows:
        preset, length_scale = row.preset.split("/")
        measured = row.name.removeprefix("length_scale.")
        found.setdefault((measured, preset), []).append((float(length_scale), row))
    return {key: sorted(points, key=itemgetter(0)) for key, points in found.items()}


def draw_curve(rows: Sequence[Row], filename: Path) -> None:
    """Draws error over length scale, one panel per measure, with 95 % intervals."""
    figure = Figure(figsize=(9.5, 3.2), layout="constrained")
    axes = dict(zip(MEASURES, figure.subplots(1, len(MEASURES)), strict=True))
    colors = {"paper": "#c2571a", "default": "#1f5fa8"}
    for (measured, preset), points in curves(rows).items():
        ax, color = axes[measured], colors[preset]
        values = [(x, row.value) for x, row in points]
        ax.plot(*zip(*values, strict=True), "o-", ms=3, color=color, label=preset)
        band = [(x, row.low, row.high) for x, row in points if row.low is not None]
        if band:
            ax.fill_between(*zip(*band, strict=True), color=color, alpha=0.15, lw=0)
    for measured, ax in axes.items():
        ax.set_title(MEASURES[measured], fontsize=10)
        ax.set(xlabel="length scale l [m]", ylim=(0.0, None))
        ax.axvline(0.3, color="0.6", ls=":", lw=1)
        ax.grid(alpha=0.25)
    first = axes[next(iter(MEASURES))]
    first.set_ylabel("distance true → completed [mm]")
    first.legend(frameon=False)
    save_figure(figure, filename, dpi=110)


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
