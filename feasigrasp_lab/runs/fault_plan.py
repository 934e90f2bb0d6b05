"""Plan of the runs of ``evaluate faults``, and their outcomes."""

import argparse
import copy
import dataclasses as dc
import itertools
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from feasigrasp.errors import ScenarioError
from feasigrasp.scenario.checks import check_scenario
from feasigrasp.scenario.sampling import load_scenario_object
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.protocols.fault_table import FAULTS, LOST, StudiedFault
from feasigrasp_lab.results.arguments import select_objects
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.runs.plan import PlannedRun, plan_run
from feasigrasp_lab.runs.studies import STUDIES
from feasigrasp_lab.runs.summary import LIMITS


@dataclass(frozen=True)
class FaultRun(PlannedRun):
    """A run with a fault, or the same without.

    Attributes:
        fault: Name of the fault; empty without.
        instant: Which of the instants.
        start: When the fault begins [s].
    """

    fault: str = ""
    instant: int = 0
    start: float = 0.0

    @property
    def id(self) -> str:
        """Name of its result file, without suffix."""
        return f"{self.fault or 'none'}-{self.instant}-{super().id}"


def nominal_runs(args: argparse.Namespace) -> list[FaultRun]:
    """The runs without a fault: one for every object, controller and instant.

    Instants differ in motion and seed, and objects in where the turn of motions begins. Instant 0
    is the beginning, to which as many are added as ``args`` asks for. With ``--quick``, one object
    and controller, and one instant that is drawn.

    Raises:
        ScenarioError: Unknown scenario, key or value.
        MeshError: Unknown object, or one that cannot be simulated.
    """
    objects = list(select_objects(args.objects).items())
    controllers, instants = args.controllers, range(1 + args.instants)
    if args.quick:
        objects, controllers, instants = objects[:1], controllers[:1], instants[1:2]
    study, runs = STUDIES["reach" if args.camera else "mocap"], []
    motions = study.scenarios
    for (j, chosen), controller, k in itertools.product(enumerate(objects), controllers, instants):
        motion = motions[(j + k) % len(motions)]
        made = plan_run(args, motion, study, chosen, "", controller, None, args.seed + k)
        runs.append(FaultRun(made.name, made.object_name, made.scenario, instant=k))
    for each in {run.object_name: run for run in runs}.values():
        load_scenario_object(each.scenario)  # a wrong mesh is reported here, not run by run
    return runs


def faulty_runs(
    nominal: Sequence[FaultRun], records: Sequence[Record], faults: Sequence[str], seed: int
) -> list[FaultRun]:
    """The runs with faults, which begin while the same run without a fault approaches, or lifts.

    At instant 0 that is at the very beginning of it; all others are drawn, for every fault, object
    and controller anew, so that few instants cover the whole approach.

    Args:
        nominal: The runs without a fault.
        records: What came of them.
        faults: Names of faults.
        seed: Draws when they begin.

    Raises:
        ScenarioError: There is no such fault.
    """
    unknown = [name for name in faults if name not in FAULTS]
    if unknown:
        raise ScenarioError(f"no fault {', '.join(unknown)}; there are {', '.join(FAULTS)}")
    return [
        _with_fault(run, record, name, seed)
        for name in faults
        for run, record in zip(nominal, records, strict=True)
    ]


def _with_fault(run: FaultRun, record: Record, name: str, seed: int) -> FaultRun:
    fault, scenario = FAULTS[name], copy.deepcopy(run.scenario)
    which = f"{name} {run.object_name} {scenario.control.controller}"
    key = [seed, run.instant, zlib.crc32(which.encode())]
    share = float(np.random.default_rng(key).random()) if run.instant else 0.0
    first, last = _window(fault, scenario, record)
    start = round(first + share * (last - first), 3)
    scenario.faults = [*scenario.faults, *fault.beginning_at(start)]  # type: ignore[list-item]
    scenario.tracker = dc.replace(scenario.tracker, **fault.tracker)
    check_scenario(scenario)
    return dc.replace(run, scenario=scenario, fault=name, start=start)


def _window(fault: StudiedFault, scenario: Scenario, record: Record) -> tuple[float, float]:
    """From when to when a fault may begin: the nominal approach, or lift."""
    grasp = scenario.sequence
    after = grasp.lift_time + grasp.shake_time + grasp.hold_time
    simulated = record["timings"]["simulated_s"] or scenario.simulation_duration
    if fault.while_lifting:
        lifting = max(simulated - after, 0.1)
        return lifting, lifting + grasp.lift_time
    return 0.0, max(simulated - after - grasp.closing_time, 0.1)


def outcome(run: FaultRun, record: Record) -> dict[str, Any]:
    """What came of a run, as one row of a table.

    ``named`` is true if the object was held, or the record has the right word for the fault: its
    cause, or a status that it entered since the fault began or that lasted until the end;
    ``noticed_s`` is when, after the fault began. ``broken`` is true if any limit was, by the
    metrics of the record; ``worst`` is which, and by how much.
    """
    fault, metrics = FAULTS[run.fault], record["metrics"]
    noticed = _noticed(run, record, fault)
    held = bool(metrics["grasp_held"])
    worst, share = max(
        ((name, metrics.get(name) or 0.0) for name in LIMITS), key=lambda pair: pair[1]
    )
    depth = metrics["obstacle_distance_min_mm"]
    in_table = depth is not None and depth < 0.0
    if share == 0.0 and in_table:
        worst, share = "obstacle_distance_min_mm", depth
    return {
        "fault": run.fault,
        "instant": run.instant,
        "start_s": run.start,
        "scenario": run.name,
        "object": run.object_name,
        "controller": run.scenario.control.controller,
        "seed": run.scenario.random_seed,
        "held": held,
        "named": held or noticed is not None or metrics.get("cause") in fault.words(run.scenario),
        "noticed_s": noticed,
        "broken": share != 0.0,
        "worst": f"{worst} {share:.3g}" if share else "",
        "cause": metrics.get("cause"),
        "crashed": record["error"] is not None,
        "error": record["error"],
    }


def false_alarm(record: Record) -> bool:
    """Whether the status of a run without a fault has the word for one after its start."""
    words = {*LOST, *(word for fault in FAULTS.values() for word in fault.named)}
    return any(code in words for time, code, *_ in record["status"] if time > 0.0)


def _noticed(run: FaultRun, record: Record, fault: StudiedFault) -> float | None:
    status, words = [*record.get("status", ())], fault.words(run.scenario)
    for number, (time, code, *_) in enumerate(status):
        if code in words and (time >= run.start or number == len(status) - 1):
            return max(float(time) - run.start, 0.0)
    return None
