"""Plan of the runs of the dynamic evaluation."""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from pathlib import Path

from feasigrasp.errors import FeasigraspError, MeshError, ScenarioError
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import positive, print_notes
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.results.arguments import add_controllers_argument, names, select_objects
from feasigrasp_lab.results.workers import Shard
from feasigrasp_lab.runs.studies import STUDIES, Study, study_of, suffix_of

#: Seeds from here on are those of the test split, and no tuning sees them. Source: definition.
FIRST_TEST_SEED = 500
#: Generated objects of the test split. Source: definition.
TEST_OBJECTS = 24


class SplitError(FeasigraspError, ValueError):
    """Objects or seeds that do not belong to the chosen split."""


class Split(StrEnum):
    """What may be looked at while constants are chosen, and what may not."""

    DEVELOPMENT = "development"
    TEST = "test"


@dataclass(frozen=True)
class PlannedRun:
    """One run of the evaluation.

    Attributes:
        name: Name of the scenario, with the suffix of a study that changes it.
        object_name: Name of the object.
        scenario: What to run, complete.
    """

    name: str
    object_name: str
    scenario: Scenario

    @property
    def id(self) -> str:
        """Name of its result file, without suffix."""
        mode, seed = self.scenario.control.mode, self.scenario.random_seed
        controller = self.scenario.controller_name.replace(":", ".")
        return f"{self.name}-{self.object_name}-{controller}-{mode}-{seed}"


@dataclass(frozen=True)
class Plan:
    """What is run, and what was asked for but is not.

    Attributes:
        runs: The runs.
        left_out: Why, by the name of the object.
    """

    runs: list[PlannedRun]
    left_out: dict[str, str] = field(default_factory=dict)

    def share(self, shard: Shard | None) -> Plan:
        """The runs of a shard; all without one."""
        if shard is None:
            return self
        return Plan(self.runs[shard.index - 1 :: shard.count], self.left_out)


def add_plan_arguments(parser: argparse.ArgumentParser, default: str) -> None:
    """Adds the arguments that choose runs; `plan` reads them.

    Args:
        parser: Parser of the command.
        default: Its study, or ``all`` of those with one variant.
    """
    choices = [*STUDIES, *(["all"] if default == "all" else [])]
    parser.add_argument("--study", choices=choices, default=default, help="Study to run.")
    parser.add_argument(
        "--split",
        type=Split,
        choices=list(Split),
        default=Split.DEVELOPMENT,
        help=f"Objects and seeds. 'test': {TEST_OBJECTS} generated objects of held-out families, "
        f"seeds from {FIRST_TEST_SEED} on.",
    )
    parser.add_argument(
        "--scenarios", type=names, help="Scenarios, separated by commas. Default: the study's."
    )
    add_controllers_argument(parser)
    parser.add_argument(
        "--mode", type=names, help="Modes, separated by commas. Default: the study's."
    )
    parser.add_argument("--seeds", type=positive, help="Number of repeats, with consecutive seeds.")
    add_scenario_arguments(parser)
    parser.set_defaults(seed=None)


def add_camera_argument(parser: argparse.ArgumentParser) -> None:
    """Adds the choice of the sensing."""
    parser.add_argument(
        "--camera",
        action="store_true",
        help="Mask and pose of the object by the wrist camera alone. Default: both are given.",
    )


def add_scenario_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds where scenarios come from, and what is changed in them."""
    default = diagram_path("dynamic.scenarios.yaml").name
    parser.add_argument(
        "--scenario-file", type=Path, help=f"File of scenarios. Default: diagrams/{default}."
    )
    text = "{object: {friction: 0.4}}"
    help_ = f"YAML applied on top of every scenario, e.g. '{text}'."
    parser.add_argument("--scenario-text", help=help_)
    parser.add_argument("--arm", help="Arm, or the file of one. Default: the scenario's.")


def plan(args: argparse.Namespace) -> Plan:
    """The runs that the arguments ask for; with ``--quick``, one object and one seed of them.

    ``args.seed`` is filled in if it is None.

    Raises:
        SplitError: Objects, seeds or a study that do not belong to the split.
        ScenarioError: Unknown scenario, key or value.
        MeshError: Unknown object, or one that cannot be simulated; objects of a folder are left
            out instead, with the reason.
    """
    chosen = _chosen_scenarios(args)
    _settle_seed(args, [study for _, study in chosen])
    runs, left_out = list[PlannedRun](), dict[str, str]()
    for name, study in chosen:
        objects = _objects(args, study)
        modes: Sequence[str] = args.mode or study.modes
        for what, repeats in _repeats(args, study, objects).items():
            made = [
                plan_run(args, name, study, (what, objects[what]), *how)
                for how in itertools.product(study.variants, args.controllers, modes, repeats)
            ]
            try:
                # A wrong mesh is reported here, not run by run.
                print_notes(load_scenario_object(made[0].scenario))
            except MeshError as error:
                if not Path(args.objects or "").is_dir():
                    raise
                left_out[what] = str(error)
                continue
            runs += {each.id: each for each in made}.values()  # one's own is not any --controllers
            if args.quick:
                for each in (each.scenario for each in made if not each.scenario.grasp.close):
                    # A run that does not end by itself is broken off [s].
                    each.simulation_duration = min(each.simulation_duration, 6.0)
                break
    if not runs:
        raise MeshError(f"{args.objects}: none of its meshes can be used: {left_out}")
    return Plan(runs, left_out)


def _chosen_scenarios(args: argparse.Namespace) -> list[tuple[str, Study]]:
    """Names of scenarios, each with its study."""
    # Curves and tables of degradations are many runs of the same kind.
    studies = [study for study in STUDIES.values() if len(study.variants) == 1]
    studies = studies if args.study == "all" else [STUDIES[args.study]]
    if not args.scenarios:
        return [(name, study) for study in studies for name in study.scenarios]
    return [
        (name, next((s for s in studies if name in s.scenarios), study_of(name)))
        for name in args.scenarios
    ]


def _settle_seed(args: argparse.Namespace, studies: Sequence[Study]) -> None:
    """Fills in the first seed, and refuses what does not belong to the split."""
    test = args.split is Split.TEST
    if args.seed is None:
        args.seed = FIRST_TEST_SEED if test else 0
    last = args.seed + max(args.seeds or study.seeds for study in studies) - 1
    if test and args.seed < FIRST_TEST_SEED:
        raise SplitError(
            f"--seed {args.seed} belongs to development; --split test takes those from "
            f"{FIRST_TEST_SEED} on"
        )
    if not test and last >= FIRST_TEST_SEED:
        raise SplitError(
            f"seed {last} belongs to the test split; give --split test, or seeds below "
            f"{FIRST_TEST_SEED}"
        )
    if test and args.objects is not None:
        raise SplitError(
            f"--objects {args.objects} is for development; --split test makes its own objects: "
            "leave --objects away"
        )
    if test and not all(study.generated for study in studies):
        raise SplitError("the paper's test is one on the paper's object: leave --split test away")


def _objects(args: argparse.Namespace, study: Study) -> dict[str, str]:
    """What is loaded, by name of the object."""
    if args.split is Split.DEVELOPMENT:
        return select_objects(args.objects or study.objects)
    # Needs a package that only training needs otherwise.
    from feasigrasp_lab.training.data.held_out_objects import write_test_objects

    return write_test_objects(args.out / "objects", 1 if args.quick else TEST_OBJECTS)


def _repeats(
    args: argparse.Namespace, study: Study, objects: Mapping[str, str]
) -> dict[str, list[int]]:
    """Seeds by object: the same for all, but in the test split every object has its own."""
    test = args.split is Split.TEST
    count = 1 if args.quick else args.seeds or (1 if test else study.seeds)
    return {
        name: [args.seed + test * index * count + k for k in range(count)]
        for index, name in enumerate(objects)
    }


def plan_run(
    args: argparse.Namespace,
    name: str,
    study: Study,
    chosen: tuple[str, str],
    variant: str,
    controller: str,
    mode: str | None,
    seed: int,
) -> PlannedRun:
    """One run, as the arguments of `add_scenario_arguments` and the study change it.

    Args:
        args: Arguments of the command.
        name: Name of the scenario.
        study: What it is part of.
        chosen: Name of the object, and what it is loaded from.
        variant: Which of the study's.
        controller: The controller.
        mode: Its mode; None for the scenario's.
        seed: Of everything.

    Raises:
        ScenarioError: The name is like one that a study makes, or the scenario is wrong.
    """
    if suffix := suffix_of(name):
        raise ScenarioError(
            f"scenario {name} ends in {suffix}, as the runs of a study do; give it another name"
        )
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    control = {"controller": controller} | ({} if mode is None else {"mode": mode})
    choice = {"control": control} | ({} if args.arm is None else {"arm": args.arm})
    scenario = deepcopy(_read_once(filename, name, args.scenario_text, json.dumps(choice)))
    scenario.random_seed = scenario.tracker.seed = seed
    scenario.object.model = chosen[1]
    study.variants[variant](scenario)
    check_scenario(scenario)
    return PlannedRun(f"{name}{variant}", chosen[0], scenario)


@cache
def _read_once(filename: Path, name: str, text: str | None, choice: str) -> Scenario:
    """A scenario without object and seed: hundreds of runs share it."""
    return load_scenario(filename, name, text, choice)
