"""``feasigrasp evaluate dynamic``: scenarios x controllers x objects x seeds, and their figures."""

from __future__ import annotations

import argparse
import csv
import json
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import joblib
from tqdm import tqdm

from feasigrasp.evaluation.arguments import add_common_arguments, names, positive, select_objects
from feasigrasp.evaluation.dynamic_summary import format_table, summary_rows
from feasigrasp.evaluation.isolated import run_isolated
from feasigrasp.evaluation.provenance import git_revision, versions
from feasigrasp.evaluation.result_files import write_summary
from feasigrasp.resources import diagram_path
from feasigrasp.scenario import Scenario, dump_scenario, load_scenario
from feasigrasp.systems.dynamic_grasp import load_scenario_object

Record = dict[str, Any]

SCENARIOS = "ReachCircular,ReachLinear,ReachSinusoidal"
OBJECTS = "mustard_bottle,soup_can,small_box"


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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/dynamic", objects=OBJECTS)
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help=f"default: {SCENARIOS}"
    )
    parser.add_argument("--controllers", type=names, default=["task", "joint"])
    parser.add_argument("--seeds", type=positive, default=2, help="repeats, with seeds that count")
    parser.add_argument("--mode", choices=("safe", "paper"), default="safe")
    parser.add_argument(
        "--scenario_file", type=Path, default=None, help="default: diagrams/dynamic.scenarios.yaml"
    )
    parser.add_argument("--scenario_text", help="YAML applied on top of every scenario")


def plan(args: argparse.Namespace) -> list[PlannedRun]:
    """The runs that the arguments ask for; with ``--quick``, one object and one seed of them.

    Raises:
        ScenarioError: Unknown scenario, key or value.
        MeshError: Unknown object, or one that cannot be simulated.
    """
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    objects = list(select_objects(args.objects).items())
    seeds = range(args.seed, args.seed + args.seeds)
    if args.quick:
        objects, seeds = objects[:1], seeds[:1]
    runs = []
    for object_name, model in objects:
        for name in args.scenarios:
            for controller in args.controllers:
                for seed in seeds:
                    choice = {
                        "random_seed": seed,
                        "object": {"model": model},
                        "control": {"controller": controller, "mode": args.mode},
                    }
                    scenario = load_scenario(filename, name, args.scenario_text, json.dumps(choice))
                    runs.append(PlannedRun(name, object_name, scenario))
        load_scenario_object(runs[-1].scenario)  # a wrong mesh is told now, not run by run
    return runs


def finished_records(
    runs: Sequence[PlannedRun], folder: Path, revision: str | None
) -> dict[str, Record]:
    """The records in a folder that need no repetition, by id of the run.

    A record counts if it came from the same scenario (object, seed, controller and mode included),
    the same revision of the code and the same versions, and if its process did not crash.
    """
    expected = {"git": revision, "versions": versions()}
    finished = {}
    for planned in runs:
        try:
            record = json.loads((folder / f"{planned.id}.json").read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            continue
        wanted = expected | {
            "scenario": planned.name,
            "scenario_yaml": dump_scenario(planned.scenario),
        }
        crashed = record.get("timings", {}).get("wall_s") is None
        if not crashed and all(record.get(key) == value for key, value in wanted.items()):
            finished[planned.id] = record
    return finished


def run_all(runs: Sequence[PlannedRun], folder: Path, jobs: int) -> Iterator[Record]:
    """Runs everything, each in its own process, and yields the records as they come.

    The threads only wait for those processes; joblib's ``parallel_config`` can send the runs to a
    cluster instead.
    """
    parallel = joblib.Parallel(jobs, prefer="threads", return_as="generator_unordered")
    yield from parallel(
        joblib.delayed(run_isolated)(planned.scenario, planned.name, folder / f"{planned.id}.json")
        for planned in runs
    )


def write_csv(records: Sequence[Record], filename: Path) -> None:
    """Writes one row per run with all its metrics."""
    heads = ("scenario", "controller", "mode", "object", "seed", "git")
    rows = [
        {head: record[head] for head in heads}
        | record["metrics"]
        | record["timings"]
        | {"error": record["error"]}
        for record in records
    ]
    with filename.open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = plan(args)
    revision = git_revision()
    folder = args.out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    records = finished_records(runs, folder, revision)
    missing = [planned for planned in runs if planned.id not in records]
    _report_reuse(runs, missing, folder, revision)
    with tqdm(total=len(runs), initial=len(records), unit="run", desc="dynamic") as bar:
        try:
            for record in run_all(missing, folder, args.jobs):
                bar.update()
                if record["error"]:
                    bar.write(f"{record['scenario']}, {record['object']}: {record['error'][:200]}")
        except KeyboardInterrupt:
            bar.write("interrupted; the same command goes on from here")
            return 130
    # From the files: they are what a later command finds too, and their order is the plan's.
    finished = [json.loads((folder / f"{planned.id}.json").read_text()) for planned in runs]
    rows = summary_rows(finished)
    write_csv(finished, args.out / "runs.csv")
    write_summary(
        args.out / "summary.json",
        command=_command(args),
        git=revision,
        seed=args.seed,
        rows=rows,
        quick=args.quick,
    )
    print(format_table(rows))
    others = sorted({str(record["git"]) for record in finished} - {str(revision)})
    if others:
        print(f"the code changed meanwhile: some runs are of {', '.join(others)}, not {revision}")
    print(f"{args.out / 'summary.json'}, {args.out / 'runs.csv'}, {folder}/*.json")
    return 0


def _command(args: argparse.Namespace) -> str:
    options = {
        "--objects": args.objects,
        "--scenarios": ",".join(args.scenarios),
        "--controllers": ",".join(args.controllers),
        "--mode": args.mode,
        "--seed": args.seed,
        "--seeds": args.seeds,
        "--scenario_file": args.scenario_file,
        "--scenario_text": args.scenario_text,
    }
    words = [str(x) for key, value in options.items() if value is not None for x in (key, value)]
    return shlex.join(["feasigrasp", "evaluate", "dynamic", *words, *["--quick"] * args.quick])


def _report_reuse(
    runs: Sequence[PlannedRun],
    missing: Sequence[PlannedRun],
    folder: Path,
    revision: str | None,
) -> None:
    outdated = sum((folder / f"{planned.id}.json").exists() for planned in missing)
    kept = len(runs) - len(missing)
    if outdated:
        print(f"{outdated} results are from another revision or setting, or crashed: run again")
    if kept:
        print(f"{kept} of {len(runs)} runs are finished already in {folder}")
        if (revision or "").endswith("-dirty"):
            print("  uncommitted changes cannot be told apart: use a new --out after changing code")
