"""``feasigrasp evaluate dynamic``: follow, grasp and lift moving objects.

``--study`` chooses what is run (``docs/developing.md`` has the table). Every run is a file of its
own: repeated, the command goes on where it was. What it was measured under is printed, and is
``conditions`` of ``summary.json``.
"""

import argparse

from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.workers import add_worker_arguments
from feasigrasp_lab.runs.plan import add_plan_arguments, plan
from feasigrasp_lab.runs.run_plan import run_plan
from feasigrasp_lab.runs.summary import format_table, summary_rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/dynamic", objects=None)
    add_plan_arguments(parser, default="reach")
    add_worker_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    return run_plan(args, plan(args), args.split, "dynamic", summary_rows, format_table)
