"""``feasigrasp evaluate hardware-loop``: grasp over the drivers' messages, with process faults.

A simulated cell and a controller as two processes: the runs of ``evaluate dynamic --study mocap``
(with ``--camera``: ``reach``), and the same with a controller, a process that perceives or plans
for it, or a guard, that is killed or stopped at random instants, with a bad network, other senders
on it, or a driver's clock that is set; beside them the same runs in one process. Judged in the
simulator's process.
"""

import argparse
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from feasigrasp.errors import FeasigraspError
from feasigrasp.runs.results.arguments import factor, positive
from feasigrasp.scenario.files import dump_scenario
from feasigrasp_lab.protocols.tuned import rows_apart
from feasigrasp_lab.results.arguments import (
    FormerOption,
    add_common_arguments,
    add_controllers_argument,
)
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.runs.hardware_network import Network
from feasigrasp_lab.runs.hardware_pair import ProcessFault, run_pair
from feasigrasp_lab.runs.isolated import run_all
from feasigrasp_lab.runs.plan import (
    PlannedRun,
    Split,
    add_camera_argument,
    add_scenario_arguments,
    plan,
)
from feasigrasp_lab.runs.summary import LIMITS

_AT_CONTROLLER = [fault for fault in ProcessFault if not (fault.at_worker or fault.at_guard)]
_GUARD_ENDS = ProcessFault.END_GUARD, ProcessFault.KILL_GUARD
#: Faults that end the run: the arm comes to rest.
_ENDING = [*_AT_CONTROLLER, *_GUARD_ENDS, Network.RIVAL, Network.FORGED]
#: Record keys of the messages received from the controller.
_RECEIVED = (
    *("request_gap_ms_max", "request_gap_ms_p99", "rest_s", "commands_missing"),
    *("commands_late", "commands_clamped", "driver_stopped_by_joint"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/hardware", objects=None)
    parser.add_argument("--seeds", type=positive, default=1, help="Number of repeats of every run.")
    add_controllers_argument(parser)
    parser.add_argument(
        "--rate",
        type=factor,
        default=1.0,
        help="Largest real-time factor: simulated seconds per second.",
    )
    parser.add_argument(
        "--process-faults",
        type=positive,
        default=100,
        help="Number of process faults in all runs together.",
    )
    parser.add_argument("--blows", action=FormerOption, dest="process_faults", type=positive)
    parser.add_argument(
        "--networks", type=positive, default=6, help="Number of runs for each network impairment."
    )
    add_camera_argument(parser)
    add_scenario_arguments(parser)
    parser.set_defaults(split=Split.DEVELOPMENT, scenarios=None, mode=["safe"])


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    args.study = "reach" if args.camera else "mocap"
    runs = plan(args).runs
    if args.quick:
        runs, args.process_faults, args.networks = runs[:1], 2, 0
    inline = run_all(runs, args.out / "inline", args.jobs, desc="one process")
    items = planned_pairs(runs, args.process_faults, args.networks, args.seed)
    # One pair after the other by default: two processes keep two processors busy.
    folder, rate, pairs = args.out / "pairs", {"rate": args.rate}, max(1, args.jobs // 2)
    outcomes = finish_all(items, folder, rate, outcome, jobs=pairs, desc="two processes")
    write_csv(args.out / "pairs.csv", outcomes)
    rows = [*rows_apart(inline, inline_rows), *rows_apart(outcomes, outcome_rows)]
    report_rows(args, "evaluate hardware-loop", rows)
    return int(any(outcome["crashed"] for outcome in outcomes))


def planned_pairs(
    runs: Sequence[PlannedRun], process_faults: int, networks: int, seed: int
) -> dict[str, dict[str, Any]]:
    """Process fault and time of every run: once without, and others in turn with a fault."""
    rng = np.random.default_rng(seed)
    faults: list[str] = list(itertools.islice(itertools.cycle(ProcessFault), process_faults))
    faults += [network for network in Network for _ in range(networks)]
    plain = [(run, "") for run in runs]
    faulted = list(zip(itertools.cycle(runs), faults, strict=False))
    # Instants of a fault are drawn from this time after the first command [s].
    return {
        f"{number}-{fault or 'none'}-{run.id}": {
            "scenario": run.name,
            "object": run.object_name,
            "seed": run.scenario.random_seed,
            "text": dump_scenario(run.scenario),
            "fault": str(fault),
            "at": float(rng.uniform(0.5, 6.0)),
        }
        for number, (run, fault) in enumerate([*plain, *faulted])
    }


def outcome(name: str, item: dict[str, Any], *, rate: float) -> list[Record]:
    """What came of one pair of processes.

    An arm that does not come to rest after a process fault of its controller counts as a broken
    limit, and so does a driver that had to stop the arm. ``item`` is one of `planned_pairs`.
    """
    about = ("scenario", "object", "seed", "fault", "at")
    record: Record = {"name": name} | {key: item[key] for key in about}
    try:
        report = run_pair(name, item["text"], rate=rate, fault=item["fault"], at=item["at"])
    except FeasigraspError as error:
        empty = dict.fromkeys((*LIMITS, *_RECEIVED, "image_to_grasps_ms", "real_time_factor"))
        record |= {"crashed": True, "error": str(error), "held": False, "broken": True} | empty
        return [record]
    metrics, received = report["metrics"], report["hardware"]
    restless = item["fault"] in _ENDING and received["rest_s"] is None
    stopped = received["driver_stopped_by_joint"] > 0
    touched = (metrics.get("obstacle_distance_min_mm") or 0.0) < 0.0
    broken = restless or stopped or touched
    broken |= any((metrics[key] or 0.0) > 0.0 for key in LIMITS)
    record |= {"crashed": False, "error": report["error"], "held": bool(metrics["grasp_held"])}
    record |= {"broken": broken} | {key: metrics[key] for key in LIMITS}
    record |= {key: received[key] for key in _RECEIVED}
    record |= {"image_to_grasps_ms": report.get("on_hardware", {}).get("image_to_grasps_ms")}
    return [record | {"real_time_factor": report["timings"]["real_time_factor"]}]


def inline_rows(records: Sequence[Record]) -> list[Row]:
    """Grasp success in one process."""
    held = [bool(record["metrics"]["grasp_held"]) for record in records]
    objects = [record["object"] for record in records]
    return [Row.percent("hardware.held_percent", "inline", held, objects)]


def outcome_rows(outcomes: Sequence[Record]) -> list[Row]:
    """Figures of the runs without a fault, with process faults, and of every network."""
    rows = []
    plain = [each for each in outcomes if not each["fault"]]
    process_faults = [each for each in outcomes if each["fault"] in _AT_CONTROLLER]
    # The times of a controller on a good network are those of the runs without a fault.
    groups = {"processes": plain, "blows": process_faults}
    others = [*(fault for fault in ProcessFault if fault not in _AT_CONTROLLER), *Network]
    groups |= {str(n): [e for e in outcomes if e["fault"] == n] for n in others}
    for preset, group in groups.items():
        if not group:
            continue
        n, broken = len(group), sum(each["broken"] for each in group)
        if preset != "blows":
            held = [each["held"] for each in group]
            objects = [each["object"] for each in group]
            rows.append(Row.percent("hardware.held_percent", preset, held, objects))
        rows.append(Row.plain("hardware.limits_broken", preset, broken, "1", n))
    for name, key, worst in (
        ("hardware.command_gap_ms.max", "request_gap_ms_max", np.max),
        ("hardware.command_gap_ms.p99", "request_gap_ms_p99", np.median),
        ("hardware.image_to_grasps_ms", "image_to_grasps_ms", np.median),
        ("hardware.real_time_factor", "real_time_factor", np.median),
    ):
        if values := [each[key] for each in plain if each[key] is not None]:
            unit = "ms" if "_ms" in name else "1"
            rows.append(Row.plain(name, "processes", float(worst(values)), unit, len(values)))
    if process_faults:
        rests = [each["rest_s"] for each in process_faults if each["rest_s"] is not None]
        rows.append(Row.plain("hardware.at_rest", "blows", len(rests), "1", len(process_faults)))
        if rests:
            rows.append(Row.plain("hardware.rest_s.max", "blows", max(rests), "s", len(rests)))
    return rows
