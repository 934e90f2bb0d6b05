"""An iiwa grasps and lifts an object at rest: ``feasigrasp run Static`` by another name.

For example::

    python diagrams/static_grasp.py --controller task --object mug --seed 3 --replay out/replay.html
"""

import sys

from feasigrasp.cli import command_parser, exit_status
from feasigrasp.commands import run


def main() -> int:
    """Runs one scenario."""
    parser = command_parser("static_grasp.py", "simulate one grasp of an object at rest")
    parser.add_argument(
        "--scenario-name", default="Static", help="Scenario; see 'feasigrasp scenarios'."
    )
    run.add_options(parser)
    args = parser.parse_args()
    return exit_status(lambda: run.main(args))


if __name__ == "__main__":
    sys.exit(main())
