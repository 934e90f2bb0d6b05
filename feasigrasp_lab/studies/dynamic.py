"""``feasigrasp evaluate dynamic``: follow, grasp and lift moving objects.

``--study`` chooses what is run (``docs/developing.md`` has the table). Every run is a file of its
own: repeated, the command goes on where it was. What it was measured under is printed, and is
``conditions`` of ``summary.json``.
"""

import argparse
from collections.abc import Sequence
from typing import Any

from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.rows import report_rows, write_csv
from feasigrasp_lab.results.workers import add_worker_arguments
from feasigrasp_lab.runs.plan import add_plan_arguments, plan
from feasigrasp_lab.runs.run_plan import conditions_text, run_plan
from feasigrasp_lab.runs.summary import format_table, summary_rows

_HEADS = ("scenario", "controller", "mode", "object", "seed", "git")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/dynamic", objects=None)
    add_plan_arguments(parser, default="reach")
    add_worker_arguments(parser)


def flat(record: Record) -> Record:
    """A run with all its metrics as one row of a table."""
    about = {head: record[head] for head in _HEADS}
    return about | record["metrics"] | record["timings"] | {"error": record["error"]}


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    return run_plan(args, plan(args), args.split, _report, desc="dynamic")


def _report(
    args: argparse.Namespace, records: Sequence[Record], found: dict[str, Any], **more: bool
) -> None:
    """Prints and writes the figures of some runs; ``partial`` if those are not all."""
    rows = summary_rows(records)
    table = f"{format_table(rows)}\n{conditions_text(found)}"
    report_rows(args, "evaluate dynamic", rows, table, conditions=found, **more)
    write_csv(args.out / "runs.csv", map(flat, records))
    _report_revisions(records)


def _report_revisions(records: Sequence[Record]) -> None:
    revision = str(git_revision())
    others = sorted({str(record["git"]) for record in records} - {revision})
    if others:
        print(f"the code changed meanwhile: some runs are of {', '.join(others)}, not {revision}")
