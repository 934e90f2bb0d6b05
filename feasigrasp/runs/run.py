"""Runs one scenario and writes its record."""

import gc
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator
from pydrake.systems.framework import Context, Diagram, EventStatus

from feasigrasp.errors import FeasigraspError, ScenarioError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.status import Status, StatusCode
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.quantities import ArrayOf
from feasigrasp.one_thread import one_thread
from feasigrasp.outputs import replacing
from feasigrasp.runs.console import StatusLine, cause_in_words, progress, verdict
from feasigrasp.runs.ghost import ghost_of, show_ghost
from feasigrasp.runs.live import LiveView
from feasigrasp.runs.metrics.cause import Cause
from feasigrasp.runs.metrics.handling import ObjectTruth
from feasigrasp.runs.metrics.motion_limits import limit_metrics
from feasigrasp.runs.metrics.reference_robot import (
    reference_robot,
    self_collision_metrics,
    torque_metrics,
)
from feasigrasp.runs.metrics.run_metrics import not_held, summarize
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.runs.metrics.tick_times import TickTimes
from feasigrasp.runs.replay import FRAMES_PER_SECOND, start_recording, write_replay
from feasigrasp.runs.results.interrupts import postponed_interrupt
from feasigrasp.runs.results.provenance import git_revision, machine, own_files, versions
from feasigrasp.runs.teleport import teleport
from feasigrasp.scenario.files import dump_scenario
from feasigrasp.scenario.sampling import make_motion
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.dynamic_grasp import make_dynamic_grasp
from feasigrasp.systems.from_scenario import make_reachability
from feasigrasp.systems.metrics import SAMPLE_PERIOD
from feasigrasp.systems.monitoring.run_log import add_run_log, read_run_log
from feasigrasp.systems.remote.remote_stage import end_processes
from feasigrasp.systems.station.directives import cell_directives

#: The ``error`` of a run that Ctrl-C ended.
INTERRUPTED = "interrupted"


@dataclass(frozen=True, eq=False)
class Result:
    """Record of a run.

    Attributes:
        record: What the result file holds; ``docs/results_schema.md`` defines it.
        log: Arrays by name, the ``time`` (n,) [s] and n samples of each of the others, which the
            same page defines; empty if nothing was logged.
        times: Sample times of the metrics [s], shape (m,).
        samples: Their samples, one row per entry of ``SAMPLE_NAMES``, shape (s, m).
    """

    record: dict[str, Any]
    log: dict[str, NDArray[np.generic]]
    times: Annotated[Array, ArrayOf(("m",), "s")]
    samples: Annotated[Array, ArrayOf(("s", "m"), finite=False)]

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def held(self) -> bool | None:
        """Whether the object was held to the end; None where the gripper was not to close."""
        return self.metrics["grasp_held"]

    @property
    def cause(self) -> str | None:
        """Why the object was not held, in words; None if it was, or was not to be."""
        return cause_in_words(self.record)

    @property
    def metrics(self) -> dict[str, Any]:
        """The figures of the run by name, see ``docs/results_schema.md``."""
        return self.record["metrics"]

    @property
    def status(self) -> tuple[Status, ...]:
        """History of the status: each with its start time."""
        return tuple(Status(t, StatusCode(code), words) for t, code, words in self.record["status"])

    @checked()
    def write_log(self, filename: str | Path) -> None:
        """Writes the log as a compressed .npz, which ``np.load`` reads without pickle.

        Raises:
            OutputError: It cannot be written.
        """
        arrays: dict[str, Any] = self.log
        with replacing(filename) as file:
            np.savez_compressed(file, **arrays)

    def __repr__(self) -> str:
        """The verdict, and what ran, in one line."""
        what = (self.record[key] for key in ("scenario", "object"))
        named = ", ".join((*filter(None, what), f"seed {self.record['seed']}"))
        return f"<Result: {verdict(self.record)} ({named})>"


@checked(ScenarioError)
def run(
    scenario: Scenario,
    name: str = "",
    *,
    log: bool = True,
    replay: str | Path | None = None,
    keep: Callable[[dict[str, Any]], None] = lambda record: None,
    line: StatusLine | None = None,
    live: LiveView | None = None,
    ghost: Scenario | None = None,
) -> Result:
    """Simulates a scenario until its grasp is over or its duration has passed.

    A solver failure of the simulation ends the run, and so do Ctrl-C and whatever a part of one's
    own raises; it is reported in ``error`` of the record, and the grasp counts as not held.

    Args:
        scenario: What to run.
        name: Its name, for the record.
        log: Whether the result has a log, of 150 kB for a simulated second.
        replay: Where to write a self-contained HTML replay.
        keep: Gets the record as soon as there is one, before the replay is written.
        line: Where to say how far the run is.
        live: Where to watch it.
        ghost: The replay shows the arm of this scenario, in another mode, as well, translucent.
    """
    say = line.show if line else lambda text: None
    say("building the diagram")
    with one_thread(), frozen():
        watched = live.meshcat if live else None
        meshcat = start_recording(watched) if replay else watched
        error = None
        with postponed_interrupt() as interrupted:
            built = time.perf_counter()
            connect = partial(add_run_log, period=scenario.control.period) if log else None
            diagram = make_dynamic_grasp(scenario, meshcat, connect=connect)
            # Made now: the revision may change while the simulation runs.
            record = crash_record(scenario, name, "")
            tick_times = TickTimes(diagram.GetSubsystemByName("controller"))
            simulator = Simulator(diagram)
            ApplySimulatorConfig(scenario.simulator_config, simulator)
            # Weakly: no garbage collector sees that a simulator keeps its monitor, and renderers
            # that are never freed leave threads, for which forked runs would wait.
            watched_run = weakref.proxy(simulator)
            simulator.set_monitor(_Monitor(watched_run, interrupted, line, live))
            if interrupted.is_set():
                raise KeyboardInterrupt  # there is nothing yet
            if live is not None:
                say(f"waiting for a browser at {live.url}; Enter starts without")
                live.wait_for_browser(interrupted)
            started = time.perf_counter()
            say("starting the simulation")
            try:
                simulator.Initialize()
                # Nor what was built: a full collection would hold up one tick for it.
                gc.freeze()
                until, reach = scenario.simulation_duration, make_reachability(scenario)
                if not scenario.execution.teleport or teleport(simulator, reach, until):
                    simulator.AdvanceTo(until)
            except Exception as failure:
                if isinstance(failure, FeasigraspError) and not isinstance(failure, RuntimeError):
                    raise  # nothing that another run would not meet as well
                error = what_failed(failure)
        if error is None and interrupted.is_set():
            error = INTERRUPTED
        ended = time.perf_counter()
        end_processes(diagram)

    say("measuring what happened")
    context = simulator.get_context()
    times, samples, metrics = measured(diagram, context, scenario, broke_off=error is not None)
    metrics |= tick_times.metrics()
    timings = timings_of(built, started, ended, context.get_time())
    record |= {"timings": timings, "metrics": metrics, "error": error}
    record |= status_history(diagram, context)
    keep(record)
    if meshcat is not None:
        pictures = diagram.GetSubsystemByName("camera_pictures").pictures
        # From the last picture of the recording on.
        over = context.get_time() - 1.0 / FRAMES_PER_SECOND
        outcome = Status(over, StatusCode.DONE, verdict(record))
    if live is not None:
        live.show(context.get_time(), outcome, pictures[-1] if pictures else None)
    if meshcat is not None and replay is not None:
        if ghost is not None:
            say(f"simulating mode {ghost.control.mode} beside it")
            way = ghost_of(ghost, context.get_time())
            show_ghost(meshcat, scenario, *way, FRAMES_PER_SECOND)
        say(f"writing {replay}")
        monitor = diagram.GetSubsystemByName("status")
        looks = monitor.looks(monitor.GetMyContextFromRoot(context))
        mode = ghost.control.mode if ghost else ""
        write_replay(meshcat, Path(replay), (*looks, outcome), pictures, mode)
    return Result(record, read_run_log(diagram, context) if log else {}, times, samples)


@contextmanager
def frozen() -> Iterator[None]:
    """Leaves what is alive here, compiled code above all, out of garbage collection meanwhile."""
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def what_failed(failure: Exception) -> str:
    """Drake's words, or ours; of what other code raised also what and where, and all on stderr."""
    where = traceback.extract_tb(failure.__traceback__)[-1]
    by_drake = type(failure) is RuntimeError and Path(where.filename) == Path(__file__)
    if by_drake or isinstance(failure, FeasigraspError):
        return str(failure)
    traceback.print_exception(failure)
    what = f"{type(failure).__name__}: {failure}".removesuffix(": ")
    return f"{what} ({where.filename}:{where.lineno}, in {where.name})"


def timings_of(built: float, started: float, ended: float, simulated: float) -> dict[str, float]:
    """Timings of a record, by the instants of building and simulation [s]."""
    return {
        "build_s": started - built,
        "wall_s": ended - started,
        "simulated_s": simulated,
        "real_time_factor": simulated / (ended - started),
    }


def crash_record(scenario: Scenario, name: str, error: str) -> dict[str, Any]:
    """The record of a run that came to no end: no metrics, no timings, and nothing held."""
    metrics: dict[str, Any] = dict.fromkeys(METRICS)
    if scenario.grasp.close:
        metrics |= not_held(Cause.BROKE_OFF)
    return {
        "scenario": name,
        "controller": scenario.controller_name,
        "mode": scenario.control.mode,
        "object": scenario.object.model,
        "seed": scenario.random_seed,
        "files": own_files(scenario),
        "git": git_revision(),
        "versions": versions(),
        "machine": machine(),
        "timings": dict.fromkeys(("build_s", "wall_s", "simulated_s", "real_time_factor")),
        "metrics": metrics,
        "error": error,
        "status": [],
        "rejected": [],
        "scenario_yaml": dump_scenario(scenario),
    }


def status_history(diagram: Diagram, context: Context) -> dict[str, Any]:
    """What the status monitor noted, for a record: ``status`` and ``rejected``."""
    monitor = diagram.GetSubsystemByName("status")
    context = monitor.GetMyContextFromRoot(context)
    status = [[s.time, str(s.code), s.detail] for s in monitor.history(context)]
    return {"status": status, "rejected": monitor.rejected(context)}


def measured(
    diagram: Diagram,
    context: Context,
    scenario: Scenario,
    *,
    broke_off: bool,
    sent: Array | None = None,
) -> tuple[Array, Array, dict[str, Any]]:
    """Times and samples of the metrics' log, and the metrics of all that was measured.

    Args:
        diagram: A simulated cell with the judging systems and logs of `make_dynamic_grasp`.
        context: Its context, at the end.
        scenario: What ran.
        broke_off: Whether the simulation failed.
        sent: Positions that the arm was sent at every tick [rad], shape (m, 7); those of
            ``log(drive)`` unless given.
    """
    station = diagram.GetSubsystemByName("station")

    def log(name: str) -> tuple[Array, Array]:
        found = diagram.GetSubsystemByName(f"log({name})").FindLog(context)
        return found.sample_times().copy(), found.data().copy()

    def output(system: str, port: str) -> Any:
        found = diagram.GetSubsystemByName(system)
        return found.GetOutputPort(port).Eval(found.GetMyContextFromRoot(context))

    times, samples = log("metrics")
    q, _ = np.split(log("arm")[1].T, 2, axis=1)
    if sent is None:
        sent = np.split(log("drive")[1], 2)[0].T
    # A simulation that breaks off does so between the logs of an instant.
    whole = min(len(sent), len(q))
    sent, q = sent[:whole], q[:whole]
    motion = make_motion(scenario)
    contact = diagram.GetSubsystemByName("contact")
    period, step = scenario.control.period, station.plant.time_step()
    limits = None
    if len(sent) and len(times):
        limits = limit_metrics(sent, log("velocity")[1].T, period, step, station.arm)
    metrics = summarize(
        samples,
        closes=scenario.grasp.close,
        lift=scenario.grasp.lift[2],
        limits=limits,
        obstacle_distance=log("obstacle_distance")[1],
        truth=ObjectTruth(
            path=np.array([motion.pose(t) for t in times]),
            contact=output("contact", "approach"),
            let_go=float(output("station", "object.let_go")[0]),
            # A solver that has failed would fail again.
            touched=not broke_off and contact.touches(output("station", "contact_results")),
            broke_off=broke_off,
        ),
    )
    if len(q):
        reference = reference_robot(cell_directives(scenario), station.arm)
        every = max(1, round(SAMPLE_PERIOD / period))
        metrics |= self_collision_metrics(reference, q[::every])
        at, torques = log("torque")
        tick = np.minimum(np.rint(at / period).astype(int), len(q) - 1)
        metrics |= torque_metrics(reference, q[tick], torques.T)
    metrics["friction"] = station.contact_friction()
    if diagram.HasSubsystemNamed("perception"):
        metrics["view_faults"] = float(output("perception", "view_faults")[0])
    return times, samples, metrics


class _Monitor:
    """Ends the run when the grasp is over, the object has fallen, or after Ctrl-C.

    It looks twice per sample, and says how far the run is.
    """

    def __init__(
        self,
        simulator: Simulator,
        interrupted: threading.Event,
        line: StatusLine | None,
        live: LiveView | None,
    ) -> None:
        diagram = simulator.get_system()
        self._interrupted, self._line = interrupted, line
        self._simulator, self._live = simulator, live
        self._sequencer = diagram.GetSubsystemByName("sequencer")
        self._status = diagram.GetSubsystemByName("status")
        self._station = diagram.GetSubsystemByName("station")
        self._camera = diagram.GetSubsystemByName("camera_pictures") if live else None
        self._object_pose = self._station.GetOutputPort("object.pose")
        self._next = 0.0
        self._began = time.perf_counter()

    def __call__(self, context: Context) -> EventStatus:
        if self._live is not None:
            self._live.pace(self._simulator, self._interrupted)
        if self._interrupted.is_set():
            return EventStatus.ReachedTermination(self._sequencer, INTERRUPTED)
        time = context.get_time()
        if time < self._next:
            return EventStatus.DidNothing()
        self._next = time + 0.5 * SAMPLE_PERIOD
        self._say(context)
        state = self._sequencer.state(self._sequencer.GetMyContextFromRoot(context))
        # One sample later than the end, so that the log shows it.
        if state.phase == Phase.DONE and time >= state.since + SAMPLE_PERIOD:
            return EventStatus.ReachedTermination(self._sequencer, "the grasp is over")
        # Beside the table there is nothing: it would fall and spin until numbers overflow.
        X_WO = self._object_pose.Eval(self._station.GetMyContextFromRoot(context))
        if X_WO.translation()[2] < -1.0:  # past the table [m]
            return EventStatus.ReachedTermination(self._station, "the object has fallen")
        return EventStatus.DidNothing()

    def _say(self, context: Context) -> None:
        if self._line is None and self._live is None:
            return
        status = self._status.status(self._status.GetMyContextFromRoot(context))
        if self._line is not None:
            wall = time.perf_counter() - self._began
            self._line.show(progress(context.get_time(), wall, status), patient=True)
        if self._live is not None and self._camera is not None:
            pictures = self._camera.pictures
            self._live.show(context.get_time(), status, pictures[-1] if pictures else None)
