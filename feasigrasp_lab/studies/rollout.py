"""``feasigrasp evaluate rollout``: follow objects without physics, to tune controllers."""

import argparse
import itertools
import time

from feasigrasp.models.choices import mode_names
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.runs.results.arguments import positive
from feasigrasp.scenario.files import dump_scenario, parse_scenario
from feasigrasp_lab.results.arguments import (
    add_common_arguments,
    add_controllers_argument,
    names,
    select_objects,
)
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, format_rows, report_rows, write_csv
from feasigrasp_lab.results.statistics import mean
from feasigrasp_lab.runs.plan import PlannedRun, add_scenario_arguments, plan_run
from feasigrasp_lab.runs.rollout import roll_out
from feasigrasp_lab.runs.studies import study_of

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
    "cpu_s",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/rollout", objects="duck")
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help="Scenarios, separated by commas."
    )
    add_controllers_argument(parser)
    parser.add_argument(
        "--seeds", type=positive, default=5, help="Number of repeats, with consecutive seeds."
    )
    parser.add_argument(
        "--mode",
        choices=mode_names(),
        default="safe",
        help="Mode of the controller.",
    )
    parser.add_argument(
        "--duration", type=float, help="Duration of a run, in seconds. Default: 3 laps."
    )
    add_scenario_arguments(parser)


def plan(args: argparse.Namespace) -> list[PlannedRun]:
    """The runs that the arguments ask for.

    Raises:
        ScenarioError: Unknown scenario, key or value.
        MeshError: A folder without meshes.
    """
    seeds = range(args.seed, args.seed + (1 if args.quick else args.seeds))
    objects = select_objects(args.objects).items()
    return [
        plan_run(args, name, study_of(name), chosen, "", controller, args.mode, seed)
        for name, controller, chosen, seed in itertools.product(
            args.scenarios, args.controllers, objects, seeds
        )
    ]


def measure(_: str, text: str, duration: float | None) -> list[Record]:
    """The metrics of the run of a scenario, given as text."""
    started = time.process_time()
    metrics = roll_out(parse_scenario(text), duration=duration).metrics
    return [metrics | {"cpu_s": time.process_time() - started}]


def summary_rows(records: dict[str, list[Record]]) -> list[Row]:
    """Means over the runs of every preset, with intervals.

    Args:
        records: Metrics of the runs, by preset.
    """
    rows = []
    for preset, runs in records.items():
        for name in runs[0]:
            values = [run[name] for run in runs if isinstance(run[name], float)]
            metric = METRICS.get(name)
            if values and (metric is None or metric.averaged):
                bounds = (metric.lower, metric.upper) if metric else (0.0, float("inf"))
                unit = metric.unit if metric else "s"
                rows.append(Row.of(f"rollout.{name}", preset, mean(values, *bounds), unit))
    return rows


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = plan(args)
    duration = 10.0 if args.quick and args.duration is None else args.duration
    # As text: a scenario with Drake's types cannot be sent to another process.
    texts = {planned.id: dump_scenario(planned.scenario) for planned in runs}
    finished = finish_all(
        texts, args.out / "runs", {"duration": duration}, measure, jobs=args.jobs, desc="rollout"
    )
    records: dict[str, list[Record]] = {}
    table = []
    for planned in runs:
        preset = f"{planned.name}/{planned.scenario.control.controller}/{args.mode}"
        (metrics,) = finished[planned.id]
        records.setdefault(preset, []).append(metrics)
        table.append({"run": planned.id, "preset": preset} | metrics)
    write_csv(args.out / "runs.csv", table)
    rows = summary_rows(records)
    printed = [row for row in rows if row.name.removeprefix("rollout.") in _PRINTED]
    report_rows(args, "evaluate rollout", rows, format_rows(printed))
    return 0
