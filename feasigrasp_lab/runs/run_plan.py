"""Runs a plan, and reports what came out of it, even if it does not come to its end."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any, Protocol

from feasigrasp.runs.results.interrupts import Unfinished
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.workers import shard_folders
from feasigrasp_lab.runs.conditions import conditions
from feasigrasp_lab.runs.isolated import report_crashes, run_all
from feasigrasp_lab.runs.plan import Plan


class Report(Protocol):
    """Prints and writes the figures of some runs."""

    def __call__(
        self,
        args: argparse.Namespace,
        records: Sequence[Record],
        found: dict[str, Any],
        **more: bool,
    ) -> None:
        """Reports records under conditions; ``partial`` if those are not all."""


def run_plan(args: argparse.Namespace, whole: Plan, split: str, report: Report, desc: str) -> int:
    """Runs a plan, or the shard of it that is asked for, and reports it.

    Args:
        args: Arguments of the command, those of `add_worker_arguments` among them.
        whole: All runs.
        split: ``development`` or ``test``, for `conditions`.
        report: Reports records.
        desc: What the progress bar is called.

    Returns:
        The exit status of the command: 1 if a run crashed.

    Raises:
        Unfinished: Ctrl-C, or a full disk; what is there is reported before.
    """
    planned = whole.share(args.shard)
    found = conditions(planned, split)
    try:
        records = run_all(
            planned.runs,
            args.out / "runs",
            args.jobs,
            desc=desc,
            cluster=args.cluster,
            elsewhere=[folder / "runs" for folder in shard_folders(args.out)],
        )
    except Unfinished as stopped:
        if stopped.records:
            report(args, stopped.records, found, partial=True)
        raise
    report(args, records, found, **({} if args.shard is None else {"partial": True}))
    return report_crashes(records)
