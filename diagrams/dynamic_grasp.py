"""An iiwa follows, grasps and lifts a moving object: ``feasigrasp run`` by another name.

For example::

    python diagrams/dynamic_grasp.py --scenario-name ReachCircular --controller task \
        --object mug --replay out/replay.html --results out/results.json
"""

import sys

from feasigrasp.cli import command_parser, exit_status
from feasigrasp.commands import run


def main() -> int:
    """Runs one scenario."""
    parser = command_parser("dynamic_grasp.py", "simulate one grasp of a moving object")
    parser.add_argument("--scenario-name", help="Scenario; see 'feasigrasp scenarios'.")
    run.add_options(parser)
    args = parser.parse_args()
    return exit_status(lambda: run.main(args))


if __name__ == "__main__":
    sys.exit(main())
