"""Timing of functions, and result rows of ``feasigrasp bench``."""

import argparse
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import Estimate

#: Units that names of rows end in, and how many are a second.
_PER_SECOND = {"us": 1e6, "ms": 1e3, "s": 1.0}


class Case(NamedTuple):
    """What is timed: row name, preset, function, and with how many things a call deals."""

    name: str
    preset: str
    function: Callable[[], object]
    items: int = 1


@dataclass(frozen=True)
class Timing(Estimate):
    """Processor time of one call: the median of n repetitions and its 95 % interval [s]."""

    low: float
    high: float


def cpu_time(function: Callable[[], object], seconds: float) -> Timing:
    """Times a function by the processor time of the process, all its threads together.

    Processor time leaves out what other processes take away by being run; what they do to caches
    and to the clock rate it cannot.

    Args:
        function: Called once before, to warm up, and then as often as fits.
        seconds: For how long [s]; there are at least 5 repetitions.
    """
    function()
    calls = 1
    # A repetition is this long, so that the clock's steps do not matter [s].
    while (elapsed := _elapsed(function, calls)) < 2e-3:
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


def timing_row(name: str, preset: str, timing: Timing, items: int = 1) -> Row:
    """A row of a timing, in the unit that its name ends in (before a dot and a size).

    Args:
        name: E.g. ``bench.network_ms.512``; with ``hz``, the row is that of calls per second.
        preset: What was timed.
        timing: Of one call.
        items: The row is the time of one of so many things that a call deals with.
    """
    unit = name.split(".")[1].rpartition("_")[2]
    if unit == "hz":
        low, high = 1 / timing.high, 1 / timing.low
        return Row(name, preset, 1 / timing.value, low, high, "Hz", timing.n)
    return Row.of(name, preset, timing, unit, _PER_SECOND[unit] / items)


def time_cases(cases: Iterable[Case], seconds: float) -> list[Row]:
    """Times cases on one thread, a row for each."""
    with threadpool_limits(1):
        return [
            timing_row(name, preset, cpu_time(function, seconds), items)
            for name, preset, function, items in tqdm(cases, desc="cases", leave=False)
        ]


def report_bench(args: argparse.Namespace, what: str, rows: Sequence[Row], **more: Any) -> None:
    """As `report_rows` for ``bench <what>``; writes ``timings.csv`` as well."""
    heads = ("name", "preset", "median", "low", "high", "unit", "repetitions")
    lines = [(r.name, r.preset, r.value, r.low, r.high, r.unit, r.n) for r in rows]
    write_csv(args.out / "timings.csv", lines, heads)
    report_rows(args, f"bench {what}", rows, **more)
