"""How long functions take, and the rows of it that a ``feasigrasp bench`` command writes."""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.results.rows import Row, report_rows, write_csv

#: What is timed: row name, preset, function.
Case = tuple[str, str, Callable[[], object]]

#: A repetition is this long, so that the clock's steps do not matter [s].
REPETITION_S = 2e-3


@dataclass(frozen=True)
class Timing:
    """Processor time of one call.

    Attributes:
        median: Over the repetitions [s].
        low: Lower end of the median's 95 % interval, from the order of the repetitions [s].
        high: Upper end [s].
        n: Number of repetitions.
    """

    median: float
    low: float
    high: float
    n: int


def cpu_time(function: Callable[[], object], seconds: float = 1.0) -> Timing:
    """Times a function by the processor time of the process, all its threads together.

    Processor time leaves out what other processes take away by being run; what they do to caches
    and to the clock rate it cannot.

    Args:
        function: Called once before, to warm up, and then as often as fits.
        seconds: For how long [s]; there are at least 5 repetitions.
    """
    function()
    calls = 1
    while (elapsed := _elapsed(function, calls)) < REPETITION_S:
        calls *= 2
    n = max(5, int(seconds / elapsed))
    times = sorted(_elapsed(function, calls) / calls for _ in range(n))
    # The number of repetitions below the true median is binomial: n/2 +- 0.98 sqrt(n).
    spread = int(0.98 * n**0.5) + 1
    low, high = times[max(n // 2 - spread, 0)], times[min(n // 2 + spread, n - 1)]
    return Timing(statistics.median(times), low, high, n)


def _elapsed(function: Callable[[], object], calls: int) -> float:
    start = time.process_time()
    for _ in range(calls):
        function()
    return time.process_time() - start


def timing_row(name: str, preset: str, timing: Timing, unit: str, factor: float) -> Row:
    """A row of a timing; ``factor`` converts seconds per call to ``unit``."""
    low, high = factor * timing.low, factor * timing.high
    return Row(name, preset, factor * timing.median, low, high, unit, timing.n)


def time_cases(cases: Iterable[Case], seconds: float, unit: str, factor: float) -> list[Row]:
    """Times cases on one thread, a row for each; ``factor`` converts seconds to ``unit``."""
    with threadpool_limits(1):
        return [
            timing_row(name, preset, cpu_time(function, seconds), unit, factor)
            for name, preset, function in tqdm(cases, desc="cases", leave=False)
        ]


def report_bench(
    args: argparse.Namespace, what: str, rows: Sequence[Row], table: str = "", **more: Any
) -> None:
    """Writes ``timings.csv`` and ``summary.json`` and prints the rows.

    Args:
        args: Arguments of the command.
        what: The command without ``feasigrasp bench``, e.g. ``kinematics``.
        rows: The figures.
        table: What is printed instead of all rows.
        **more: Further entries of the summary.
    """
    heads = ("name", "preset", "median", "low", "high", "unit", "repetitions")
    lines = [(r.name, r.preset, r.value, r.low, r.high, r.unit, r.n) for r in rows]
    write_csv(args.out / "timings.csv", lines, heads)
    report_rows(args, f"bench {what}", rows, table, **more)
