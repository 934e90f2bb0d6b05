"""Which runs the dynamic evaluation consists of."""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from feasigrasp.resources import diagram_path
from feasigrasp.results.arguments import names, positive, print_notes, select_objects
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.scenario.schema import Scenario

#: Object of the size of the paper's, 5.8 x 5.4 x 4.1 cm.
PAPER_OBJECT = "duck"
#: With ``--quick``, a run that does not end by itself is broken off [s].
_QUICK_DURATION = 6.0


@dataclass(frozen=True)
class Study:
    """One part of the evaluation, and what its scenarios are run with unless told otherwise.

    Attributes:
        scenarios: Their names.
        modes: Modes of the controllers.
        objects: Names of built-in objects, separated by commas.
        seeds: Repeats.
        change: What is changed in every scenario, as `load_scenario` takes it.
    """

    scenarios: tuple[str, ...]
    modes: tuple[str, ...]
    objects: str
    seeds: int
    change: dict[str, Any]


#: ``paper`` repeats the paper's dynamic test, on an object of its size and two larger ones;
#: ``reach`` grasps and lifts moving objects of all kinds; ``obstacle`` does so beside a wall.
STUDIES = {
    "paper": Study(
        ("PaperCircular", "PaperLinear", "PaperSinusoidal"),
        ("safe", "paper"),
        f"{PAPER_OBJECT},small_box,soup_can",
        5,
        {},
    ),
    "reach": Study(
        ("ReachCircular", "ReachLinear", "ReachSinusoidal"),
        ("safe",),
        "apple,ball,banana,box,duck,l_block,mustard_bottle,pear,screwdriver,small_box,soup_can,"
        "spray_can",
        3,
        {"object": {"friction": 0.6}},
    ),
    "obstacle": Study(
        ("ReachObstacle",),
        ("safe",),
        f"{PAPER_OBJECT},soup_can,small_box",
        3,
        {"object": {"friction": 0.6}},
    ),
}


@dataclass(frozen=True)
class PlannedRun:
    """One run of the evaluation.

    Attributes:
        name: Name of the scenario.
        object_name: Name of the object.
        scenario: What to run, complete.
    """

    name: str
    object_name: str
    scenario: Scenario

    @property
    def id(self) -> str:
        """Name of its result file, without suffix."""
        control = self.scenario.control
        seed = self.scenario.random_seed
        return f"{self.name}-{self.object_name}-{control.controller}-{control.mode}-{seed}"


def add_plan_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments that choose runs; `plan` reads them."""
    parser.add_argument(
        "--study",
        choices=(*STUDIES, "all"),
        default="all",
        help="part of the evaluation (default: all)",
    )
    parser.add_argument(
        "--scenarios", type=names, help="names of scenarios, instead of those of the study"
    )
    parser.add_argument("--controllers", type=names, default=["task", "joint"])
    parser.add_argument(
        "--mode", type=names, help="safe, paper or both, separated by commas (default: the study's)"
    )
    parser.add_argument("--seeds", type=positive, help="repeats, with seeds that count")
    add_scenario_arguments(parser)


def add_scenario_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds where scenarios come from, and what is changed in them."""
    default = diagram_path("dynamic.scenarios.yaml").name
    parser.add_argument("--scenario_file", type=Path, help=f"default: diagrams/{default}")
    text = "{tracker: {latency: 0.05, position_noise: 0.002, rotation_noise: 0.0175}}"
    help_ = f"YAML applied on top of every scenario, e.g. '{text}'"
    parser.add_argument("--scenario_text", help=help_)


def study_of(scenario_name: str) -> Study:
    """The study that a scenario belongs to; of a scenario of one's own, ``reach``."""
    return next(
        (study for study in STUDIES.values() if scenario_name in study.scenarios), STUDIES["reach"]
    )


def plan(args: argparse.Namespace) -> list[PlannedRun]:
    """The runs that the arguments ask for; with ``--quick``, one object and one seed of them.

    Raises:
        ScenarioError: Unknown scenario, key or value.
        MeshError: Unknown object, or one that cannot be simulated.
    """
    runs = []
    studies = STUDIES.values() if args.study == "all" else [STUDIES[args.study]]
    for name in args.scenarios or [each for part in studies for each in part.scenarios]:
        study = study_of(name)
        objects = list(select_objects(args.objects or study.objects).items())
        seeds = list(range(args.seed, args.seed + (args.seeds or study.seeds)))
        modes: Sequence[str] = args.mode or study.modes
        if args.quick:
            objects, seeds = objects[:1], seeds[:1]
        for chosen in objects:
            for controller, mode, seed in itertools.product(args.controllers, modes, seeds):
                planned = plan_run(args, name, chosen, controller, mode, seed, study.change)
                scenario = planned.scenario
                if args.quick and not scenario.grasp.close:
                    duration = min(scenario.simulation_duration, _QUICK_DURATION)
                    scenario.simulation_duration = duration
                runs.append(planned)
            # A wrong mesh is told now, not run by run.
            print_notes(load_scenario_object(runs[-1].scenario))
    return runs


def plan_run(
    args: argparse.Namespace,
    name: str,
    chosen: tuple[str, str],
    controller: str,
    mode: str,
    seed: int,
    change: dict[str, Any],
) -> PlannedRun:
    """One run, as the arguments of `add_scenario_arguments` change it.

    Args:
        args: Arguments of the command.
        name: Name of the scenario.
        chosen: Name of the object, and what it is loaded from.
        controller: The controller.
        mode: Its mode.
        seed: Of everything.
        change: What is changed in the scenario before all that.
    """
    choice = {
        "random_seed": seed,
        "object": {"model": chosen[1]},
        "control": {"controller": controller, "mode": mode},
    }
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    texts = json.dumps(change), args.scenario_text, json.dumps(choice)
    return PlannedRun(name, chosen[0], load_scenario(filename, name, *texts))
