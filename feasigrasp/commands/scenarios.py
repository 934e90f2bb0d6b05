"""``feasigrasp scenarios``: list the scenarios that there are."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from feasigrasp.resources import diagram_path
from feasigrasp.scenario.files import load_scenario, scenario_names
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.scenario.schema import Scenario

#: Time between the positions that tell an object's speed [s].
_STEP = 0.05


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--scenario_file", type=Path, help="a file of scenarios (default: the packaged ones)"
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    names = scenario_names(filename)
    width = max(map(len, names), default=0)
    for name in names:
        print(f"{name:{width}s}  {describe(load_scenario(filename, name))}")
    print(f"from {filename}")
    return 0


def describe(scenario: Scenario) -> str:
    """A scenario in half a line: object, speed, what is done with it, and for how long."""
    motion, duration = make_motion(scenario), scenario.simulation_duration
    times = np.arange(0.0, max(duration, 2.0 * _STEP), _STEP)
    path = np.array([motion.pose(time)[:3, 3] for time in times])
    speed = np.linalg.norm(np.diff(path, axis=0), axis=1).max() / _STEP
    end = "grasped and lifted" if scenario.grasp.close else "followed with an open gripper"
    return f"{scenario.object.model} at up to {100.0 * speed:.0f} cm/s, {end}; {duration:.3g} s"
