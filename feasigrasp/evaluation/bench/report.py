"""What a ``feasigrasp bench`` command writes and prints."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from typing import Any

from feasigrasp.evaluation.bench.timing import Timing
from feasigrasp.results.provenance import git_revision
from feasigrasp.results.row_table import format_rows
from feasigrasp.results.rows import Row, write_summary


def timing_row(name: str, preset: str, timing: Timing, unit: str, factor: float) -> Row:
    """A row of a timing; ``factor`` converts seconds per call to ``unit``."""
    low, high = factor * timing.low, factor * timing.high
    return Row(name, preset, factor * timing.median, low, high, unit, timing.n)


def report_bench(args: argparse.Namespace, what: str, rows: Sequence[Row], **more: Any) -> None:
    """Writes ``timings.csv`` and ``summary.json`` and prints the rows.

    Args:
        args: Arguments of the command; uses ``out``, ``seed`` and ``quick``.
        what: The command without ``feasigrasp bench`` and without seed, e.g. ``kinematics``.
        rows: The figures.
        **more: Further entries of the summary.
    """
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "timings.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "preset", "median", "low", "high", "unit", "repetitions"])
        writer.writerows(
            [row.name, row.preset, row.value, row.low, row.high, row.unit, row.n] for row in rows
        )
    write_summary(
        args.out / "summary.json",
        command=f"feasigrasp bench {what} --seed {args.seed}" + " --quick" * args.quick,
        git=git_revision(),
        seed=args.seed,
        rows=rows,
        quick=args.quick,
        **more,
    )
    print(format_rows(rows))
    print(args.out / "summary.json")
