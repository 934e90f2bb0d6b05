"""Parallel work: threads, array jobs, or a Dask cluster."""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import joblib

from feasigrasp.errors import FeasigraspError
from feasigrasp.runs.results.provenance import git_revision, versions

Result = TypeVar("Result")

#: How long workers are waited for [s]. Source: guessed.
_PATIENCE = 60.0


class ClusterError(FeasigraspError, RuntimeError):
    """A cluster that there is not, or whose workers cannot do the work."""


@dataclass(frozen=True)
class Shard:
    """One of several commands that share their work.

    Attributes:
        index: Which one, from 1 on.
        count: How many there are.
    """

    index: int
    count: int

    @classmethod
    def read(cls, text: str) -> Shard:
        """Reads ``i/n`` from the command line."""
        match = re.fullmatch(r"(\d+)/(\d+)", text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise argparse.ArgumentTypeError(f"{text!r} is no share; give i/n, from 1/n to n/n")
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"

    @property
    def folder(self) -> str:
        """Name of the folder of its results, in that of all."""
        return f"shard-{self.index}-of-{self.count}"


def add_worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds ``--shard`` and ``--cluster``."""
    parser.add_argument(
        "--shard",
        type=Shard.read,
        metavar="I/N",
        help="Do every N-th run only, from the I-th on, for job arrays. The results are in OUT/"
        "shard-I-of-N; the same command without --shard merges all of them.",
    )
    parser.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="Run on this Dask scheduler, e.g. tcp://host:8786; see docs/developing.md.",
    )


def shard_folders(out: Path) -> list[Path]:
    """The folders of all shards in a folder of results."""
    return sorted(out.glob("shard-*-of-*"))


def in_threads(
    work: Callable[..., Result], tasks: Mapping[str, tuple[Any, ...]], jobs: int
) -> Iterator[tuple[str, Result]]:
    """Does the tasks in threads, which is enough for work that waits for processes.

    Args:
        work: Does one; its arguments are those of the task.
        tasks: Arguments by name.
        jobs: Threads.

    Yields:
        Name and result of each, as they come.
    """

    def one(name: str) -> tuple[str, Result]:
        return name, work(*tasks[name])

    parallel = joblib.Parallel(jobs, prefer="threads", return_as="generator_unordered")
    yield from parallel(joblib.delayed(one)(name) for name in tasks)


def in_processes(
    work: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    jobs: int,
    *,
    ordered: bool = False,
) -> Iterator[Result]:
    """Does the tasks in processes that end with this one, however that ends.

    Args:
        work: Does one; its arguments are those of the task.
        tasks: Arguments of each.
        jobs: Processes.
        ordered: Whether results come in the order of the tasks.

    Yields:
        The result of each.
    """
    how = "generator" if ordered else "generator_unordered"
    yield from joblib.Parallel(jobs, return_as=how)(
        joblib.delayed(_in_process)(os.getpid(), work, task) for task in tasks
    )


def _in_process(command: int, work: Callable[..., Result], task: tuple[Any, ...]) -> Result:
    if os.getpid() != command:
        _end_with(command)
    return work(*task)


@cache
def _end_with(parent: int) -> None:
    """Ends this process within a second of its parent; loky's would wait in a pipe for ever."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def on_cluster(
    work: Callable[..., Result], tasks: Mapping[str, tuple[Any, ...]], address: str
) -> Iterator[tuple[str, Result | Exception]]:
    """Does the tasks on a Dask cluster; those of a worker that dies are done by another one.

    Args:
        work: Does one on a worker; arguments and result travel.
        tasks: Arguments by name.
        address: Of the scheduler.

    Yields:
        Name and result of each, as they come; the exception of one that failed, or whose workers
        died again and again.

    Raises:
        ClusterError: Dask is not installed; there is no such scheduler, or it has no workers; they
            are daemonic, or run other code.
    """
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        raise ClusterError("--cluster needs Dask: pip install 'feasigrasp[cluster]'") from error
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise ClusterError(f"--cluster {address}: no Dask scheduler answers ({error})") from error
    with client:
        _check_workers(client, address)
        names = {
            client.submit(work, *arguments, pure=False): name for name, arguments in tasks.items()
        }
        for future in as_completed(list(names)):
            failure = future.exception()
            yield names[future], future.result() if failure is None else failure
            future.release()


def made_with() -> dict[str, Any]:
    """The code that results depend on: its revision and the versions."""
    return {"git": git_revision(), "versions": versions()}


def about_worker() -> dict[str, Any]:
    """What must be right of a worker: it may start processes, and has this code."""
    return {"daemon": multiprocessing.current_process().daemon, **made_with()}


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        raise ClusterError(
            f"--cluster {address}: the scheduler has no worker; start some with 'dask worker'"
        ) from error
    mine = made_with()
    for worker, found in client.run(about_worker).items():
        if found.pop("daemon"):
            raise ClusterError(
                f"worker {worker} is a daemonic process, which may not start others, and every run "
                "is a process of its own: start workers with 'dask worker --no-nanny', or with "
                "DASK_DISTRIBUTED__WORKER__DAEMON=False in their environment"
            )
        for what, value in mine.items():
            if found[what] != value:
                raise ClusterError(
                    f"worker {worker} has another {what} than this command: {found[what]}, not "
                    f"{value}; install the same on both"
                )
