"""``feasigrasp guard``: forward a controller's commands to an arm, and brake it when they stop.

It belongs on the computer of the arm's driver, and serves ``feasigrasp run --hardware --no-guard``,
one after the other. It keeps the arm clear of the scenario's hand and cell. Ctrl-C ends it as soon
as the arm rests. See ``docs/hardware.md``.
"""

import argparse

from feasigrasp.commands.run import add_scenario_name, add_scenario_options, load
from feasigrasp.systems.hardware import guard
from feasigrasp.systems.hardware.guard import make_guarded_cell


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_scenario_name(parser)
    add_scenario_options(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    name, scenario = load(args, on_hardware=True)
    cell = make_guarded_cell(scenario)
    say = (
        f"guarding the arm of {name} on {args.lcm_url}, at {100 * cell.options.speed:.3g}% of its "
        "velocity limits at most (--speed); Ctrl-C ends it at rest"
    )
    guard.main(args.lcm_url, lambda: print(say, flush=True), cell, alone=True)
    return 0
