"""Runs one scenario and writes what came out of it."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus
from threadpoolctl import threadpool_limits

from feasigrasp.evaluation.runs.motion_limits import JointTicks
from feasigrasp.evaluation.runs.replay import start_recording, write_replay
from feasigrasp.evaluation.runs.run_metrics import METRICS, summarize
from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.results.interrupts import postponed_interrupt
from feasigrasp.results.provenance import git_revision, machine, versions
from feasigrasp.scenario.files import dump_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.metrics import SAMPLE_PERIOD

#: The ``error`` of a run that Ctrl-C ended.
INTERRUPTED = "interrupted"


@dataclass(frozen=True, eq=False)
class RunResult:
    """One run.

    Attributes:
        record: What the result file holds; ``docs/results_schema.md`` defines it.
        times: Sample times [s], shape (n,).
        samples: Samples, one row per entry of ``SAMPLE_NAMES``, shape (s, n).
    """

    record: dict[str, Any]
    times: Array
    samples: Array


def run(
    scenario: Scenario,
    name: str = "",
    *,
    replay: Path | None = None,
    keep: Callable[[dict[str, Any]], None] = lambda record: None,
) -> RunResult:
    """Simulates a scenario until its grasp is over or its duration has passed.

    A solver failure of the simulation ends the run, and so does Ctrl-C; it is reported in ``error``
    of the record, and the grasp counts as not held.

    Args:
        scenario: What to run.
        name: Its name, for the record.
        replay: Where to write a self-contained HTML replay.
        keep: Gets the record as soon as there is one, before the replay is written.
    """
    # Made now: the revision may change while the simulation runs.
    record = crash_record(scenario, name, "")
    # The pipeline's matrices are small: a second BLAS thread costs more than it brings.
    with threadpool_limits(1):
        # What is alive by now, compiled code above all, stays: not worth traversing again.
        gc.freeze()
        meshcat = start_recording() if replay else None
        error = None
        with postponed_interrupt() as interrupted:
            built = time.perf_counter()
            diagram = make_dynamic_grasp(scenario, meshcat)
            simulator = Simulator(diagram)
            ApplySimulatorConfig(scenario.simulator_config, simulator)
            simulator.set_monitor(_StopWhenDone(diagram, interrupted))
            if interrupted.is_set():
                raise KeyboardInterrupt  # there is nothing yet
            started = time.perf_counter()
            try:
                simulator.Initialize()
                simulator.AdvanceTo(scenario.simulation_duration)
            except RuntimeError as failure:
                error = str(failure)
        if error is None and interrupted.is_set():
            error = INTERRUPTED
        ended = time.perf_counter()

    context = simulator.get_context()
    times, samples, metrics = _measured(diagram, context, scenario)
    if error is not None and metrics["grasp_held"] is not None:
        metrics["grasp_held"] = False
    simulated = context.get_time()
    timings = {
        "build_s": started - built,
        "wall_s": ended - started,
        "simulated_s": simulated,
        "real_time_factor": simulated / (ended - started),
    }
    record |= {"timings": timings, "metrics": metrics, "error": error}
    keep(record)
    if meshcat is not None and replay is not None:
        write_replay(meshcat, replay)
    return RunResult(record, times, samples)


def crash_record(scenario: Scenario, name: str, error: str) -> dict[str, Any]:
    """The record of a run that came to no end: no metrics, no timings, and nothing held."""
    metrics: dict[str, Any] = dict.fromkeys(METRICS)
    metrics["grasp_held"] = False if scenario.grasp.close else None
    return {
        "scenario": name,
        "controller": scenario.control.controller,
        "mode": scenario.control.mode,
        "object": scenario.object.model,
        "seed": scenario.random_seed,
        "git": git_revision(),
        "versions": versions(),
        "machine": machine(),
        "timings": dict.fromkeys(("build_s", "wall_s", "simulated_s", "real_time_factor")),
        "metrics": metrics,
        "error": error,
        "scenario_yaml": dump_scenario(scenario),
    }


def _measured(
    diagram: Diagram, context: Context, scenario: Scenario
) -> tuple[Array, Array, dict[str, Any]]:
    """Times and samples of the metrics' log, and the metrics of all logs."""

    def log(name: str) -> tuple[Array, Array]:
        found = diagram.GetSubsystemByName(f"log({name})").FindLog(context)
        return found.sample_times().copy(), found.data().copy()

    times, samples = log("metrics")
    commanded, measured = (log(name)[1][IIWA_7.joints :].T for name in ("drive", "arm"))
    metrics = summarize(
        samples,
        closes=scenario.grasp.close,
        ticks=JointTicks(commanded, measured, scenario.control.period),
        obstacle_distance=log("obstacle_distance")[1],
    )
    return times, samples, metrics


class _StopWhenDone:
    """A monitor that ends the run when the grasp is over; it looks twice per sample.

    It ends it after Ctrl-C as well.
    """

    def __init__(self, diagram: Diagram, interrupted: threading.Event) -> None:
        self._interrupted = interrupted
        self._sequencer = diagram.GetSubsystemByName("sequencer")
        self._next = 0.0

    def __call__(self, context: Context) -> EventStatus:
        if self._interrupted.is_set():
            return EventStatus.ReachedTermination(self._sequencer, INTERRUPTED)
        time = context.get_time()
        if time < self._next:
            return EventStatus.DidNothing()
        self._next = time + 0.5 * SAMPLE_PERIOD
        state = self._sequencer.state(self._sequencer.GetMyContextFromRoot(context))
        # One sample later than the end, so that the log shows it.
        if state.phase == Phase.DONE and time >= state.since + SAMPLE_PERIOD:
            return EventStatus.ReachedTermination(self._sequencer, "the grasp is over")
        return EventStatus.DidNothing()
