"""Compiles kernels in as many processes as there are processors.

Stamp files beside the compiled code record what is compiled, of which sources, and for which
processor.
"""

import hashlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path

import joblib
import numba
from numba.core.codegen import get_host_cpu_features

from feasigrasp.models.arguments import checked
from feasigrasp.outputs import write_text
from feasigrasp.warm_up.kernels import FILE, Kernel, all_callees, load_kernels

_MODELS = Path(__file__).parents[1] / "models"


@checked()
def warm_up(
    groups: Collection[str], report: Callable[[str], None] = lambda progress: None
) -> list[str]:
    """Compiles what runs of these groups call and what is not in numba's cache.

    Args:
        groups: Which runs, of `feasigrasp.warm_up.GROUPS`.
        report: Gets how far it is, in words, when a kernel and what it calls are compiled.

    Returns:
        What could not be compiled, and why; a run compiles it when it is called.
    """
    kernels = load_kernels(groups)
    # With more processes than that, most would wait for the longest kernel.
    count = min(joblib.cpu_count(), 8)
    command = [sys.executable, "-m", f"{__package__}.worker"]
    # Started before this process loads the modules itself.
    workers = [
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(count)
    ]
    try:
        work = _Work(kernels, report)
        with ThreadPoolExecutor(count) as threads:
            list(threads.map(work.do_all, workers))
    finally:
        for worker in workers:
            worker.kill()
            worker.communicate()
    if work.left:
        return [*work.failures, f"{len(work.left)} others: no process is left"]
    for group in groups:
        write_text(_stamp(group), _key())
    return work.failures


class _Work:
    """What is still to be compiled, and who compiles what.

    A function that several kernels call should be compiled once: who is free takes the kernel that
    shares the least with those that are being compiled, and of these the one with the least to do.

    Attributes:
        failures: What could not be compiled, and why.
        left: Kernels that no worker has taken; at the end those for which none was left.
    """

    def __init__(self, kernels: Sequence[Kernel], report: Callable[[str], None]) -> None:
        self.failures: list[str] = []
        self.left = set(kernels)
        self._report = report
        self._callees = {kernel: _callees_of(kernel) for kernel in kernels}
        self._doing = set[Kernel]()
        self._all = {k: n for callees in self._callees.values() for k, n in callees.items()}
        self._compiled: set[str] = set()
        self._lock, self._begun = threading.Lock(), time.monotonic()

    def do_all(self, worker: subprocess.Popen[str]) -> None:
        """Has a worker compile one after the other, until there is none left or the worker dies."""
        assert worker.stdin is not None and worker.stdout is not None
        while (kernel := self._take()) is not None:
            try:
                worker.stdin.write(f"{kernel.module}\t{kernel.name}\t{kernel.signature}\n")
                worker.stdin.flush()
                answer = worker.stdout.readline()
            except BrokenPipeError:
                answer = ""
            self._finish(kernel, answer.strip() if answer else "its process died")
            if not answer:
                return

    def _take(self) -> Kernel | None:
        with self._lock:
            if not self.left:
                return None
            busy = set[str]().union(*(self._callees[kernel] for kernel in self._doing))
            busy -= self._compiled

            def rank(kernel: Kernel) -> tuple[int, int]:
                callees = self._callees[kernel].items()
                shared = sum(length for name, length in callees if name in busy)
                return shared, sum(n for name, n in callees if name not in self._compiled)

            kernel = min(self.left, key=rank)
            self.left.remove(kernel)
            self._doing.add(kernel)
            return kernel

    def _finish(self, kernel: Kernel, failure: str) -> None:
        with self._lock:
            self._doing.remove(kernel)
            self._compiled |= self._callees[kernel].keys()
            if failure:
                self.failures.append(f"{kernel.module}.{kernel.name}: {failure}")
            done = sum(self._all[name] for name in self._compiled)
            passed = time.monotonic() - self._begun
            seconds_left = passed * (sum(self._all.values()) / done - 1.0)
            left = f"about {seconds_left:.0f} s left"
            self._report(f"compiled {len(self._compiled)} of {len(self._all)} functions, {left}")


def _callees_of(kernel: Kernel) -> dict[str, int]:
    try:
        return all_callees(kernel.function())
    except (ImportError, AttributeError):
        return {f"{kernel.module}.{kernel.name}": 1}  # the worker says so


def cache_folder() -> Path:
    """Cache folder of numba for one function; a RuntimeError if none can be written to.

    It is ``NUMBA_CACHE_DIR``, else beside the source, else the user's (``~/.cache/numba``).
    """
    from feasigrasp.models.geometry.se3_kernels import inverse_kernel

    path = inverse_kernel.stats.cache_path
    assert path is not None  # it is one that is kept
    return Path(path)


@checked()
def is_warm(groups: Collection[str]) -> bool:
    """Whether all that these runs call is compiled, for this processor and of these sources."""
    stamps = map(_stamp, groups)
    return all(stamp.is_file() and stamp.read_text() == _key() for stamp in stamps)


def _stamp(group: str) -> Path:
    return cache_folder() / f"warm-up-{group}.stamp"


@cache
def _key() -> str:
    machine = f"{sys.version} {numba.__version__} {get_host_cpu_features()}"
    known = hashlib.sha256(machine.encode())
    for source in [FILE, *sorted(_MODELS.rglob("*.py"))]:
        known.update(source.read_bytes())
    return known.hexdigest()
