"""How long a function takes."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass

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
