"""``feasigrasp driver``: serve an arm whose driver has messages of its own.

It translates between them and those of guard and controller, on the arm's computer, beside
``feasigrasp guard`` or ``feasigrasp run --hardware``. See ``docs/hardware.md``.
"""

import argparse

from feasigrasp.commands.run import add_lcm_option
from feasigrasp.systems.hardware import channels
from feasigrasp.systems.hardware.bridge import Bridge, driver_names, load_driver
from feasigrasp.systems.hardware.guard import end_at_signals
from feasigrasp.systems.hardware.priority import Priority, real_time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("driver", choices=driver_names(), help="Driver of the arm.")
    add_lcm_option(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    driver = load_driver(args.driver, args.lcm_url)
    bridge = Bridge(channels.open_lcm(args.lcm_url), driver)
    end_at_signals(bridge.end, alone=True)
    print(f"serving {args.driver} on {args.lcm_url}; Ctrl-C ends it once the arm rests", flush=True)
    with real_time(Priority.DRIVER):
        bridge.serve()
    return 0
