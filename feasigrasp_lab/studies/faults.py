"""``feasigrasp evaluate faults``: inject faults into every stage, and check limits and messages.

Every fault begins with the run and at several instants that are drawn, with both controllers and
several objects; before them the same runs without a fault, which give the time of the approach.
Every run is a file of its own: repeated, the command goes on where it was.
"""

import argparse
import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from feasigrasp.runs.results.arguments import positive
from feasigrasp.scenario.files import dump_scenario
from feasigrasp_lab.protocols.fault_table import FAULTS
from feasigrasp_lab.protocols.tuned import rows_apart
from feasigrasp_lab.results.arguments import add_common_arguments, add_controllers_argument, names
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped
from feasigrasp_lab.runs.fault_plan import FaultRun, false_alarm, faulty_runs, nominal_runs, outcome
from feasigrasp_lab.runs.fault_probe import blind_pairs, leaks, rest_times
from feasigrasp_lab.runs.isolated import report_crashes, run_all
from feasigrasp_lab.runs.plan import add_camera_argument, add_scenario_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/faults", objects="duck,soup_can,small_box")
    add_controllers_argument(parser)
    parser.add_argument("--faults", type=names, help="Faults, separated by commas. Default: all.")
    parser.add_argument(
        "--instants", type=positive, default=5, help="Number of random start times of a fault."
    )
    add_camera_argument(parser)
    add_scenario_arguments(parser)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    nominal = nominal_runs(args)
    before = run_all(nominal, args.out / "nominal", args.jobs, desc="without a fault")
    runs = faulty_runs(nominal, before, args.faults or list(FAULTS), args.seed)
    records = run_all(runs, args.out / "runs", args.jobs, desc="faults")
    outcomes = [outcome(*pair) for pair in zip(runs, records, strict=True)]
    write_csv(args.out / "runs.csv", outcomes)
    alarms = [false_alarm(record) for record in before]
    rows = [
        *rows_apart(outcomes, outcome_rows),
        Row.percent(
            "faults.false_alarm_percent", "none", alarms, [run.object_name for run in nominal]
        ),
        *_probe_rows(args, nominal, runs),
    ]
    report_rows(args, "evaluate faults", rows)
    return report_crashes(records)


def outcome_rows(outcomes: Sequence[Record]) -> list[Row]:
    """Figures of every fault, and of all of them, by each run's `outcome`."""
    groups = grouped(outcomes, lambda each: str(each["fault"])) | {"all": list(outcomes)}
    rows = []
    for preset, group in groups.items():
        n, objects = len(group), [each["object"] for each in group]
        held, named = ([each[key] for each in group] for key in ("held", "named"))
        noticed = [each["noticed_s"] for each in group if each["noticed_s"] is not None]
        crashes, broken = (sum(each[key] for each in group) for key in ("crashed", "broken"))
        rows += [
            Row.plain("faults.crashes", preset, crashes, "1", n),
            Row.plain("faults.limits_broken", preset, broken, "1", n),
            Row.percent("faults.named_percent", preset, named, objects),
            Row.percent("faults.held_percent", preset, held, objects),
        ]
        if noticed:
            median = float(np.median(noticed))
            rows.append(Row.plain("faults.noticed_s", preset, median, "s", len(noticed)))
    return rows


def _probe_rows(
    args: argparse.Namespace, nominal: Sequence[FaultRun], runs: Sequence[FaultRun]
) -> list[Row]:
    """How often truth leaks, and how soon the arm is at rest when the pose is lost for good."""
    first = {run.scenario.control.controller: run for run in reversed(nominal)}
    items: dict[str, Any] = {
        f"leak-{name}-{controller}": {"pair": [dump_scenario(each) for each in pair]}
        for controller, run in first.items()
        for name, pair in blind_pairs(run.scenario).items()
    }
    for run in runs:
        if run.fault == "pose_nan":  # after it the arm must come to rest: it is watched for 2.5 s
            scenario = copy.deepcopy(run.scenario)
            scenario.simulation_duration = run.start + scenario.tracker.silence + 2.5
            items[f"rest-{run.id}"] = {"text": dump_scenario(scenario), "lost_at": run.start}
    results = finish_all(items, args.out / "probes", {}, probe, jobs=args.jobs, desc="probes")
    leaking = [result["leaks"] for result in results if "leaks" in result]
    rows = [Row.plain("faults.truth_leaks", "all", sum(leaking), "1", len(leaking))]
    rests = [result for result in results if "rest_s" in result]
    for key in ("rest_s", "rest_pushed_s") if rests else ():
        longest = max(result[key] for result in rests)
        rows.append(Row.plain(f"faults.{key}", "all", longest, "s", len(rests)))
    return rows


def probe(_: str, item: Record) -> list[Record]:
    """What one probe finds."""
    if "pair" in item:
        return [{"leaks": leaks(item["pair"])}]
    rest = rest_times(item["text"], item["lost_at"])
    return [{"rest_s": rest.untouched_s, "rest_pushed_s": rest.any_s}]
