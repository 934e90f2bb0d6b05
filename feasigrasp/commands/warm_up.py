"""``feasigrasp warm-up``: compile the kernels of runs, for containers and CI.

``feasigrasp run`` does it too, for what it needs itself.
"""

import argparse
import sys
import time
from collections.abc import Collection

from feasigrasp.errors import FeasigraspError
from feasigrasp.runs.console import StatusLine
from feasigrasp.warm_up import GROUPS, is_warm, warm_up


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "controllers",
        nargs="*",
        metavar="CONTROLLER",
        help=f"Controllers of the runs to compile for: {' and '.join(GROUPS)}. Default: all.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    unknown = set(args.controllers) - set(GROUPS)
    if unknown:
        raise FeasigraspError(f"no controller {min(unknown)!r}; give {' or '.join(GROUPS)}")
    groups = args.controllers or GROUPS
    if is_warm(groups):
        print("all that runs call is compiled")
        return 0
    return int(not compile_in_advance(groups))


def compile_in_advance(groups: Collection[str]) -> bool:
    """Compiles the kernels of groups of runs, with progress; returns whether all succeed.

    It says so on standard error: what a run prints is about the run.
    """
    began, line = time.monotonic(), StatusLine()
    print("compiling what runs call: once, for a minute or two", file=sys.stderr, flush=True)
    line.show("loading the functions")
    try:
        failures = warm_up(groups, line.show)
    finally:
        line.clear()
    for failure in failures:
        print(f"not compiled: {failure}", file=sys.stderr)
    print(f"compiled in {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
    return not failures
