"""``feasigrasp guard``: forward a controller's commands to an arm, and brake it when they stop.

It belongs on the computer of the arm's driver, and serves ``feasigrasp run --hardware --no-guard``,
one after the other. Ctrl-C ends it as soon as the arm rests. See ``docs/hardware.md``.
"""

from __future__ import annotations

import argparse

from feasigrasp.commands.run import HARDWARE_SPEED, add_lcm_option, add_speed_option
from feasigrasp.systems.hardware import guard


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_speed_option(parser)
    add_lcm_option(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    speed = HARDWARE_SPEED if args.speed is None else args.speed
    say = (
        f"guarding the arm on {args.lcm_url}, at {100 * speed:.3g}% of its velocity limits at most "
        "(--speed); Ctrl-C ends it at rest"
    )
    guard.main(args.lcm_url, lambda: print(say, flush=True), speed=speed, alone=True)
    return 0
