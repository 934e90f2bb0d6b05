"""``feasigrasp evaluate rollout``: the control loop without physics, to tune controllers with."""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import shlex
import time
from pathlib import Path
from typing import Any

import joblib
from tqdm import tqdm

from feasigrasp.evaluation.runs.rollout import roll_out
from feasigrasp.evaluation.runs.rollout_metrics import ROLLOUT_METRICS
from feasigrasp.resources import diagram_path
from feasigrasp.results.arguments import add_common_arguments, names, positive, select_objects
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.row_table import format_rows
from feasigrasp.results.rows import Row, write_json, write_summary
from feasigrasp.results.statistics import mean
from feasigrasp.scenario.files import dump_scenario, load_scenario, parse_scenario
from feasigrasp.scenario.schema import Scenario

Record = dict[str, Any]

SCENARIOS = "PaperCircular,PaperLinear,PaperSinusoidal"
#: Metrics of the printed table.
_PRINTED = (
    "gripper_object_distance_cm_mean",
    "manipulability_mean",
    "self_collision_percent",
    "joint_limit_violation_percent",
    "velocity_limit_violation_percent",
    "acceleration_limit_violation_percent",
    "tracked_percent",
    "settling_time_s",
    "grasp_switches",
    "regrip_cost_cm",
    "cpu_s",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/rollout", objects="duck")
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help=f"default: {SCENARIOS}"
    )
    parser.add_argument("--controllers", type=names, default=["task", "joint"])
    parser.add_argument("--seeds", type=positive, default=5, help="repeats, with seeds that count")
    parser.add_argument("--mode", choices=("safe", "paper"), default="safe")
    parser.add_argument("--duration", type=float, help="length of a run [s]; default: three laps")
    parser.add_argument(
        "--scenario_file", type=Path, default=None, help="default: diagrams/dynamic.scenarios.yaml"
    )
    parser.add_argument(
        "--scenario_text",
        help="YAML applied on top of every scenario, e.g. "
        "'{tracker: {latency: 0.05, position_noise: 0.002, rotation_noise: 0.0175}}'",
    )


def plan(args: argparse.Namespace) -> dict[str, tuple[str, Scenario]]:
    """The runs that the arguments ask for: by id, the preset and the scenario.

    Raises:
        ScenarioError: Unknown scenario, key or value.
        MeshError: A folder without meshes.
    """
    filename = args.scenario_file or diagram_path("dynamic.scenarios.yaml")
    seeds = range(args.seed, args.seed + (1 if args.quick else args.seeds))
    objects = select_objects(args.objects)
    runs = {}
    for name, controller, (object_name, model), seed in itertools.product(
        args.scenarios, args.controllers, objects.items(), seeds
    ):
        choice = {
            "random_seed": seed,
            "tracker": {"seed": seed},
            "object": {"model": model},
            "control": {"controller": controller, "mode": args.mode},
        }
        scenario = load_scenario(filename, name, args.scenario_text, json.dumps(choice))
        preset = f"{name}/{controller}/{args.mode}"
        runs[f"{name}-{object_name}-{controller}-{args.mode}-{seed}"] = preset, scenario
    return runs


def _run(text: str, duration: float | None, filename: Path) -> None:
    started = time.process_time()
    metrics = roll_out(parse_scenario(text), duration=duration).metrics
    cpu = time.process_time() - started
    write_json({"key": _key(text, duration), "metrics": metrics | {"cpu_s": cpu}}, filename)


def _key(text: str, duration: float | None) -> Record:
    return {
        "git": git_revision(),
        "versions": versions(),
        "scenario_yaml": text,
        "duration": duration,
    }


def _finished(filename: Path, text: str, duration: float | None) -> bool:
    try:
        return bool(json.loads(filename.read_text())["key"] == _key(text, duration))
    except (FileNotFoundError, json.JSONDecodeError, KeyError):
        return False


def summary_rows(records: dict[str, list[Record]]) -> list[Row]:
    """Means over the runs of every preset, with intervals.

    Args:
        records: Metrics of the runs, by preset.
    """
    rows = []
    for preset, runs in records.items():
        for name in runs[0]:
            values = [run[name] for run in runs if isinstance(run[name], float)]
            metric = ROLLOUT_METRICS.get(name)
            if values and name != "grasp_held" and not name.startswith("object_end"):
                bounds = (metric.lower, metric.upper) if metric else (0.0, float("inf"))
                unit = metric.unit if metric else "s"
                rows.append(Row.of(f"rollout.{name}", preset, mean(values, *bounds), unit))
    return rows


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = plan(args)
    folder = args.out / "runs"
    folder.mkdir(parents=True, exist_ok=True)
    duration = 10.0 if args.quick and args.duration is None else args.duration
    # As text: a scenario with Drake's types cannot be sent to another process.
    texts = {name: dump_scenario(scenario) for name, (_, scenario) in runs.items()}
    missing = [n for n in runs if not _finished(folder / f"{n}.json", texts[n], duration)]
    if len(missing) < len(runs):
        print(f"{len(runs) - len(missing)} of {len(runs)} runs are finished already in {folder}")
    parallel = joblib.Parallel(args.jobs, return_as="generator_unordered")
    work = parallel(
        joblib.delayed(_run)(texts[name], duration, folder / f"{name}.json") for name in missing
    )
    try:
        for _ in tqdm(work, total=len(missing), unit="run", desc="rollout"):
            pass
    except KeyboardInterrupt:
        print("interrupted; the same command goes on from here")
        return 130
    records: dict[str, list[Record]] = {}
    table: list[Record] = []
    for name, (preset, _) in runs.items():
        metrics = json.loads((folder / f"{name}.json").read_text())["metrics"]
        records.setdefault(preset, []).append(metrics)
        table.append({"run": name, "preset": preset} | metrics)
    with (args.out / "runs.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(table[0]))
        writer.writeheader()
        writer.writerows(table)
    rows = summary_rows(records)
    write_summary(
        args.out / "summary.json",
        command=_command(args),
        git=git_revision(),
        seed=args.seed,
        rows=rows,
        quick=args.quick,
    )
    print(format_rows([row for row in rows if row.name.removeprefix("rollout.") in _PRINTED]))
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
        "--duration": args.duration,
        "--scenario_file": args.scenario_file,
        "--scenario_text": args.scenario_text,
    }
    words = [str(x) for key, value in options.items() if value is not None for x in (key, value)]
    return shlex.join(["feasigrasp", "evaluate", "rollout", *words, *["--quick"] * args.quick])
