"""Result rows of ``feasigrasp evaluate`` and ``feasigrasp bench``, and their files."""

from __future__ import annotations

import argparse
import csv
import io
import time
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, SupportsFloat

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from feasigrasp.outputs import write_json, write_text
from feasigrasp.runs.results.provenance import git_revision, machine, versions
from feasigrasp_lab.results.arguments import command_line
from feasigrasp_lab.results.statistics import Estimate, proportion, share_of_objects


@dataclass(frozen=True)
class Row:
    """A row of a summary.

    Attributes:
        name: What is measured, e.g. ``dynamic.held_percent``.
        preset: Under which conditions, e.g. ``ReachLinear/task/safe``.
        value: The figure.
        low: Lower end of its 95 % interval; None without repeats.
        high: Upper end.
        unit: Its unit.
        n: Number of runs or samples behind it.
        tuned: Whether constants were chosen on these runs; None where that has no meaning.
    """

    name: str
    preset: str
    value: float
    low: float | None
    high: float | None
    unit: str
    n: int
    tuned: bool | None = None

    @classmethod
    def plain(cls, name: str, preset: str, value: SupportsFloat, unit: str, n: int) -> Row:
        """A row without an interval."""
        return cls(name, preset, float(value), None, None, unit, n)

    @classmethod
    def of(cls, name: str, preset: str, estimate: Estimate, unit: str, factor: float = 1.0) -> Row:
        """A row from an estimate; ``factor`` converts its figures to ``unit``."""
        low, high = (b if b is None else factor * b for b in (estimate.low, estimate.high))
        return cls(name, preset, factor * estimate.value, low, high, unit, estimate.n)

    @classmethod
    def percent(
        cls, name: str, preset: str, outcomes: ArrayLike, objects: Sequence[Hashable] = ()
    ) -> Row:
        """A row of how many percent of some outcomes are true.

        Args:
            name: What is measured.
            preset: Under which conditions.
            outcomes: True or false per run.
            objects: The object of each, for `share_of_objects`; without any, runs are independent
                and the interval is Wilson's.
        """
        true = np.asarray(outcomes, dtype=bool)
        if len(objects) > 0:
            share = share_of_objects(true, objects)
        else:
            share = proportion(int(true.sum()), len(true))
        return cls.of(name, preset, share, "%", 100.0)


def write_csv(
    filename: Path,
    rows: Iterable[Mapping[str, Any] | Sequence[Any]],
    heads: Sequence[str] = (),
    floats: str = "",
) -> None:
    """Writes a table.

    Args:
        filename: Where; its folder is made if need be.
        rows: Its lines, sequences or mappings; of mappings, other entries are left out.
        heads: Names of the columns; by default the keys of the first row.
        floats: Format of floating point numbers, e.g. ``.6g``.
    """
    table = list(rows)
    columns = list(heads or table[0])
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    for row in table:
        cells = [row[head] for head in columns] if isinstance(row, Mapping) else row
        if floats:
            cells = [format(c, floats) if isinstance(c, float) else c for c in cells]
        writer.writerow(cells)
    write_text(filename, text.getvalue())


def cholesky_ms() -> float:
    """Time of LAPACK's Cholesky factorization (potrf) of a 1024 x 1024 matrix, best of 5 [ms].

    Computing times of different machines are compared by their ratio to it.
    """
    matrix = np.eye(1024) + 1e-3
    times = []
    for _ in range(5):
        start = time.perf_counter()
        lapack.dpotrf(matrix, lower=1)
        times.append(time.perf_counter() - start)
    return round(1e3 * min(times), 2)


def write_summary(
    filename: Path, command: str, git: str | None, seed: int, rows: Sequence[Row], **more: Any
) -> None:
    """Writes ``summary.json``, see ``docs/results_schema.md``; ``more`` are further entries.

    The command is a whole command line, ``git`` the revision.
    """
    content = {
        "command": command,
        "git": git,
        "seed": seed,
        "versions": versions(),
        "machine": machine() | {"potrf_1024_ms": cholesky_ms()},
        **more,
        "rows": [asdict(row) for row in rows],
    }
    write_json(content, filename)


def format_rows(rows: Sequence[Row]) -> str:
    """A line per row: name, preset, value with its interval, unit, number of samples."""
    names = max((len(row.name) for row in rows), default=0)
    presets = max((len(row.preset) for row in rows), default=0)
    lines = []
    for row in rows:
        bounds = "" if row.low is None else f"[{row.low:.4g}, {row.high:.4g}]"
        lines.append(
            f"{row.name:{names}s}  {row.preset:{presets}s}  {row.value:10.4g} {row.unit:6s}"
            f" {bounds:24s} n = {row.n}"
        )
    return "\n".join(lines)


def report_rows(
    args: argparse.Namespace, command: str, rows: Sequence[Row], table: str = "", **more: Any
) -> None:
    """Prints the rows of a command and writes ``summary.json``.

    Args:
        args: Arguments of the command, as `add_common_arguments` makes them.
        command: Its name, e.g. ``evaluate shape``.
        rows: The figures.
        table: What is printed instead of all rows.
        **more: Further entries of the summary.
    """
    print(table or format_rows(rows), flush=True)  # first: the disk may be full
    line = command_line(args, command)
    filename = args.out / "summary.json"
    write_summary(filename, line, git_revision(), args.seed, rows, quick=args.quick, **more)
    files = sorted(p.name for p in args.out.iterdir() if p.is_file() and p.name[0] != ".")
    print(f"{args.out}: {', '.join(files)}")
