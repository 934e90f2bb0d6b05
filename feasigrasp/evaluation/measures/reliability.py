"""Does the field know what it does not know? Predicted deviation against actual error."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from feasigrasp.models.arrays import Array
from feasigrasp.results.rows import Row, write_csv

#: Groups of equally many completed points, by predicted deviation.
_BINS = 12


def write_reliability(
    records: Sequence[dict[str, Any]], built_in: Collection[str], folder: Path
) -> list[Row]:
    """Writes ``reliability.csv`` and ``reliability.png`` of one-view completions.

    Args:
        records: Records of `feasigrasp.evaluation.studies.shape.evaluate_object`.
        built_in: Names of the objects that the prediction was calibrated on.
        folder: Where the files go.

    Returns:
        By group of objects, the mean difference between predicted deviation and mean error of the
        bins, ``shape.calibration_error_mm``, and their rank correlation.
    """
    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    lines: list[tuple[Any, ...]] = []
    rows, top = [], 0.0
    groups = {"calibrated on": True, "held out": False}
    for label, inside in groups.items():
        chosen = [
            r
            for r in records
            if (r["condition"], r["preset"]) == ("1view", "default")
            and (r["object"] in built_in) == inside
        ]
        if not chosen:
            continue
        error = 1e3 * np.concatenate([r["error"] for r in chosen])
        predicted = 1e3 * np.concatenate([r["deviation"] for r in chosen])
        table = _binned(predicted, error)
        lines += [(label, float(p), float(m), float(q), int(n)) for p, m, q, n in table]
        axes.plot(table[:, 0], table[:, 1], "o-", label=f"mean error, objects {label}")
        axes.plot(table[:, 0], table[:, 2], ":", color=axes.lines[-1].get_color(), label="90 %")
        top = max(top, table[:, :2].max())
        gap = float(np.abs(table[:, 0] - table[:, 1]).mean())
        preset = "default" + ("/builtin" if inside else "/others")
        rows.append(Row.plain("shape.calibration_error_mm", preset, gap, "mm", len(error)))
    axes.plot([0, top], [0, top], color="0.6", lw=1, label="perfect")
    axes.set(xlabel="predicted deviation [mm]", ylabel="distance to the true surface [mm]")
    axes.legend(fontsize=8)
    figure.savefig(folder / "reliability.png", dpi=150)
    heads = ("group", "predicted_mm", "mean_error_mm", "p90_error_mm", "points")
    write_csv(folder / "reliability.csv", lines, heads, ".3f")
    return rows


def _binned(predicted: Array, error: Array) -> Array:
    """Mean prediction, mean and 90 % quantile of the error, and count of each bin, (b, 4)."""
    parts = np.array_split(np.argsort(predicted), _BINS)
    return np.array(
        [
            [predicted[p].mean(), error[p].mean(), np.quantile(error[p], 0.9), len(p)]
            for p in parts
            if len(p)
        ]
    )
