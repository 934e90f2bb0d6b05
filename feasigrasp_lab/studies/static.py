"""``feasigrasp evaluate static``: grasp and lift objects at rest, as in the paper's Table I.

An object lies at a pose drawn from the seed in a cube of 10 cm in front of the camera; the arm
starts at home, moves there, closes, lifts, shakes and holds (protocols: ``docs/developing.md``).
Objects without a true grasp for the hand are named beside the table, with the reason. Every run is
a file of its own: repeated, the command goes on where it was.
"""

import argparse
import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common.schema import Rotation

from feasigrasp.errors import MeshError, ScenarioError
from feasigrasp.models.choices import ControlSpace, controller_names
from feasigrasp.models.grasps.samplers import SamplerName, sampler_names
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.runs.results.arguments import positive
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.paper.judge import JudgeMethod
from feasigrasp_lab.protocols.changes import Change, both, setting
from feasigrasp_lab.protocols.tuned import rows_apart
from feasigrasp_lab.results.arguments import add_common_arguments, names, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, format_rows
from feasigrasp_lab.results.statistics import grouped, mean_of_objects
from feasigrasp_lab.results.workers import add_worker_arguments
from feasigrasp_lab.runs.plan import (
    Plan,
    Split,
    add_camera_argument,
    add_scenario_arguments,
    plan_run,
)
from feasigrasp_lab.runs.run_plan import run_plan
from feasigrasp_lab.runs.studies import Study
from feasigrasp_lab.runs.summary import handling_rows
from feasigrasp_lab.training.data.grasp_examples import true_input
from feasigrasp_lab.training.data.grasp_labels import GRASPABLE, is_graspable
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps


def honest(scenario: Scenario) -> None:
    """The scenario as it is: any orientation, friction 0.5 to 0.7, noisy images, late grasps."""


def hard(scenario: Scenario) -> None:
    """Friction 0.3, the hand 5 mm and 5 degrees off its nominal pose, twice the mass."""
    scenario.object.friction = 0.3
    scenario.object.mass_factor = 2.0
    scenario.execution.position_error = 0.005
    scenario.execution.angle_error = math.radians(5.0)


def paper(scenario: Scenario) -> None:
    """As the paper's scripts: friction 100, one orientation, 0.1 kg, the arm put at a grasp."""
    scenario.object.friction = 100.0
    scenario.object.rotation = Rotation.Identity()
    scenario.object.mass = 0.1
    scenario.execution.teleport = True
    scenario.grasp.dwell = 0.0  # it is at the grasp: nothing to wait for


PROTOCOLS: dict[str, Change] = {each.__name__: each for each in (honest, hard, paper)}

#: What a sampler is followed by, by the name of the stage.
_STAGES = {
    "": {"perception.filter": False, "reachability.method": JudgeMethod.NONE.value},
    "+filter": {"perception.filter": True, "reachability.method": JudgeMethod.NONE.value},
    "+filter+reachability": {
        "perception.filter": True,
        "reachability.method": JudgeMethod.IK.value,
    },
}
#: The whole pipeline: what the protocols run with when nothing is left out.
WHOLE = f"{SamplerName.NETWORK}+filter+reachability"


#: The paper's ablation for each of the samplers: alone, with the filter, with reachability as well.
ABLATIONS: dict[str, Change] = {
    f"{sampler}{stage}": setting({"perception.sampler": sampler} | keys)
    for sampler in sampler_names()
    for stage, keys in _STAGES.items()
}


#: The scenario by whether pose and mask are measured by the camera.
SCENARIOS = {False: "Static", True: "StaticCamera"}
#: Why an object is left out whose surface has no grasp.
_NO_GRASP = (
    "its true surface has no grasp for this hand: valid contact pairs start at fewer than "
    f"{GRASPABLE} of its points"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/static", objects="builtin")
    parser.add_argument(
        "--protocols", type=names, default=list(PROTOCOLS), help="Protocols, separated by commas."
    )
    parser.add_argument(
        "--trials", type=positive, default=10, help="Number of trials of every object."
    )
    parser.add_argument(
        "--ablation",
        action="store_true",
        help="Run each sampler alone, with the filter, and with reachability as well.",
    )
    parser.add_argument(
        "--controller",
        choices=[*map(str, controller_names())],
        default=str(ControlSpace.TASK),
        help="Controller.",
    )
    add_camera_argument(parser)
    add_scenario_arguments(parser)
    add_worker_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    return run_plan(args, plan(args), Split.DEVELOPMENT, "static", summary_rows, _table)


def plan(args: argparse.Namespace) -> Plan:
    """The trials: the same poses for every object, protocol and ablation.

    With ``--quick``, two trials of two objects.

    Raises:
        MeshError: Nothing is left that can be grasped.
        ScenarioError: Unknown protocol.
    """
    scenario = SCENARIOS[args.camera]
    study = Study((scenario,), variants=_variants(args.protocols, ablation=args.ablation))
    objects, left_out = _graspable(args)
    if not objects:
        raise MeshError(f"{args.objects}: nothing can be grasped: {left_out}")
    trials = range(args.seed, args.seed + (2 if args.quick else args.trials))
    runs = [
        plan_run(args, scenario, study, chosen, variant, args.controller, "safe", seed)
        for variant, chosen, seed in itertools.product(study.variants, objects.items(), trials)
    ]
    return Plan(runs, left_out)


def _variants(protocols: Sequence[str], *, ablation: bool) -> dict[str, Any]:
    """What a scenario is changed by, by the end of its runs' names."""
    unknown = [name for name in protocols if name not in PROTOCOLS]
    if unknown:
        raise ScenarioError(f"--protocols {', '.join(unknown)}: choose of {', '.join(PROTOCOLS)}")
    found = {f"-{name}": PROTOCOLS[name] for name in protocols}
    if ablation:
        found |= {
            f"-{name}-{part}": both(PROTOCOLS[name], change)
            for name, (part, change) in itertools.product(protocols, ABLATIONS.items())
            if part != WHOLE  # that is the protocol itself
        }
    return found


def _graspable(args: argparse.Namespace) -> tuple[dict[str, str], dict[str, str]]:
    """The objects that the hand could hold, and why not the others, by name."""
    objects = select_objects(args.objects)
    if args.quick:
        objects = dict(list(objects.items())[:2])
    judged = finish_all(objects, args.out / "objects", {}, judge, jobs=args.jobs, desc="objects")
    reasons = {name: each["left_out"] for name, each in zip(objects, judged, strict=True)}
    return (
        {name: what for name, what in objects.items() if reasons[name] is None},
        {name: reason for name, reason in reasons.items() if reason is not None},
    )


def judge(name: str, item: str) -> list[Record]:
    """Why an object is left out; None if it is not."""
    try:
        truth = TrueGrasps(load_object(item).mesh)
    except MeshError as error:
        if Path(item).is_file():
            return [{"left_out": str(error)}]
        raise
    surface = true_input(truth, np.random.default_rng(0))
    graspable = is_graspable(truth, surface, ParallelGripper())
    return [{"left_out": None if graspable else _NO_GRASP}]


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Grasp success and causes of failure, by protocol, ablation and object (`rows_apart`).

    The scenario of each record is ``Static[Camera]-<protocol>[-<part>]``.
    """
    return rows_apart(records, _summary_rows)


def _summary_rows(records: Sequence[Record]) -> list[Row]:
    rows = []
    for scenario, group in grouped(records, itemgetter("scenario")).items():
        preset = scenario.partition("-")[2].replace("-", "/", 1)
        rows += _outcomes(preset, group)
        if "/" not in preset:
            rows += _time_rows(preset, group)
            rows += [
                replace(row, name=row.name.replace("dynamic.", "static."))
                for row in handling_rows(preset, group)
            ]
            for name, of_object in grouped(group, lambda run: Path(run["object"]).stem).items():
                rows += _outcomes(f"{preset}/{name}", of_object, "static.object_")[:1]
    whole = [row for row in rows if row.name == "static.held_percent" and "/" not in row.preset]
    if any("/" in row.preset for row in rows if row.name == "static.held_percent"):
        rows += [replace(row, preset=f"{row.preset}/{WHOLE}") for row in whole]
    return rows


def _time_rows(preset: str, group: Sequence[Record]) -> list[Row]:
    """How long a trial takes, diagram and simulation, by the clock."""
    ended = [record for record in group if record["timings"]["wall_s"] is not None]
    if not ended:
        return []
    seconds = [record["timings"]["build_s"] + record["timings"]["wall_s"] for record in ended]
    taken = mean_of_objects(seconds, [record["object"] for record in ended], 0.0)
    return [Row.of("static.run_s", preset, taken, "s")]


def _outcomes(preset: str, group: Sequence[Record], prefix: str = "static.") -> list[Row]:
    """The share of trials that held, and of each cause of those that did not."""
    objects = [record["object"] for record in group]
    held = [bool(record["metrics"]["grasp_held"]) for record in group]
    shares = {"held_percent": held}
    for cause in sorted({r["metrics"]["cause"] for r in group} - {None}):
        shares[f"cause.{cause}_percent"] = [r["metrics"]["cause"] == cause for r in group]
    return [Row.percent(f"{prefix}{name}", preset, so, objects) for name, so in shares.items()]


def _table(rows: Sequence[Row]) -> str:
    """What is printed of them: not those of single objects."""
    return format_rows(
        [row for row in rows if row.name.startswith("static.") and "object" not in row.name]
    )
