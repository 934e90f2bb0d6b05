"""``feasigrasp sim``: simulate a cell behind the messages of its drivers, and judge a run.

The other process is ``feasigrasp run SCENARIO --hardware``, with the same ``--speed``, by which
whoever carries the object here judges how long a lift takes. See ``docs/hardware.md``.
"""

import argparse
from functools import partial

from feasigrasp.commands import run
from feasigrasp.outputs import check_outputs
from feasigrasp.runs.console import StatusLine
from feasigrasp.runs.hardware.cell import simulate_cell
from feasigrasp.runs.results.arguments import factor, output, print_notes
from feasigrasp.runs.results.interrupts import STATUS
from feasigrasp.runs.run import INTERRUPTED
from feasigrasp.scenario.sampling import load_scenario_object


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    run.add_scenario_name(parser)
    run.add_scenario_options(parser)
    parser.add_argument(
        "--results", type=output(".json", ""), metavar="FILE.json", help="Write the run's record."
    )
    parser.add_argument(
        "--rate",
        type=factor,
        default=1.0,
        help="Largest real-time factor: simulated seconds per second. Less gives a slow computer "
        "time to control.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    check_outputs({"--results": args.results}, run.files_read(args))
    name, scenario = run.load(args, on_hardware=True)
    print(run.speed_text(scenario.control.speed, on_hardware=True), flush=True)
    print_notes(load_scenario_object(scenario))
    line = StatusLine()
    keep = partial(run.keep, results=args.results, line=line)
    try:
        record = simulate_cell(scenario, name, args.lcm_url, args.rate, keep, line)
    finally:
        line.clear()
    return {None: 0, INTERRUPTED: STATUS}.get(record["error"], 1)
