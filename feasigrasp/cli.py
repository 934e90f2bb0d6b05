"""The ``feasigrasp`` command."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from feasigrasp import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: Arguments without the program name; ``sys.argv`` when None.

    Returns:
        The exit status of the process.
    """
    parser = argparse.ArgumentParser(
        prog="feasigrasp", description="Feasible grasping of moving objects."
    )
    parser.add_argument("--version", action="version", version=f"feasigrasp {__version__}")
    parser.parse_args(argv)
    parser.print_help()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
