"""``feasigrasp evaluate dynamic``: follow, grasp and lift moving objects.

Without options it runs everything behind the tables in ``docs/dynamic.md``; ``--study`` chooses a
part of it. Every run is a file of its own: repeated, the command goes on where it was.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from feasigrasp.evaluation.runs.isolated import report_crashes, run_all
from feasigrasp.evaluation.runs.plan import add_plan_arguments, plan
from feasigrasp.evaluation.runs.summary import format_table, summary_rows
from feasigrasp.results.arguments import add_common_arguments
from feasigrasp.results.finished import Record
from feasigrasp.results.interrupts import Unfinished
from feasigrasp.results.provenance import git_revision
from feasigrasp.results.rows import report_rows, write_csv

_HEADS = ("scenario", "controller", "mode", "object", "seed", "git")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/dynamic", objects=None)
    add_plan_arguments(parser)


def flat(record: Record) -> Record:
    """A run with all its metrics as one row of a table."""
    about = {head: record[head] for head in _HEADS}
    return about | record["metrics"] | record["timings"] | {"error": record["error"]}


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = plan(args)
    try:
        records = run_all(runs, args.out / "runs", args.jobs, desc="dynamic")
    except Unfinished as stopped:
        if stopped.records:
            _report(args, stopped.records, partial=True)
        raise
    _report(args, records)
    return report_crashes(records)


def _report(args: argparse.Namespace, records: Sequence[Record], **more: bool) -> None:
    """Prints and writes the figures of some runs; ``partial`` if those are not all."""
    rows = summary_rows(records)
    report_rows(args, "evaluate dynamic", rows, format_table(rows), **more)
    write_csv(args.out / "runs.csv", map(flat, records))
    _report_revisions(records)


def _report_revisions(records: Sequence[Record]) -> None:
    revision = str(git_revision())
    others = sorted({str(record["git"]) for record in records} - {revision})
    if others:
        print(f"the code changed meanwhile: some runs are of {', '.join(others)}, not {revision}")
