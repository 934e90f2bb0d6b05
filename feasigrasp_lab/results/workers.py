"""Parallel work: processes, or shares of a job array."""

from __future__ import annotations

import argparse
import os
import re
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

import joblib

from feasigrasp.runs.results.provenance import git_revision, versions

Result = TypeVar("Result")


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
    """Adds ``--shard``."""
    parser.add_argument(
        "--shard",
        type=Shard.read,
        metavar="I/N",
        help="Do every N-th run only, from the I-th on, for job arrays. The results are in OUT/"
        "shard-I-of-N; the same command without --shard merges all of them.",
    )


def in_processes(
    work: Callable[..., Result],
    tasks: Sequence[tuple[Any, ...]],
    jobs: int,
    *,
    ordered: bool = False,
) -> Iterator[Result]:
    """Does the tasks, arguments of ``work``, in processes that end with this one, however it ends.

    Yields:
        The result of each, in their order only if ``ordered``.
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


def made_with() -> dict[str, Any]:
    """The code that results depend on: its revision and the versions."""
    return {"git": git_revision(), "versions": versions()}
