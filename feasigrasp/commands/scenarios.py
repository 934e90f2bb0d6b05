"""``feasigrasp scenarios``: list the scenarios."""

import argparse
from pathlib import Path

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import PACKAGED, load_scenario, scenario_names
from feasigrasp.scenario.parts import Part
from feasigrasp.scenario.sampling import largest_speed
from feasigrasp.scenario.schema import Scenario


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--scenario-file", type=Path, help="File of scenarios. Default: the packaged ones."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    filename = args.scenario_file or diagram_path(PACKAGED)
    names = scenario_names(filename)
    width = max(map(len, names), default=0)
    for name in names:
        print(f"{name:{width}s}  {describe(load_scenario(filename, name))}")
    print(f"from {filename}")
    return 0


def describe(scenario: Scenario) -> str:
    """A scenario in half a line: object, speed, what is done with it, and for how long."""
    own = Part.MOTION in scenario.parts  # which is code of others, and not run to be listed
    pace = "by its own motion" if own else f"at up to {100.0 * largest_speed(scenario):.0f} cm/s"
    end = "grasped and lifted" if scenario.grasp.close else "followed with an open gripper"
    return f"{scenario.object.model} {pace}, {end}; {scenario.simulation_duration:.3g} s"
