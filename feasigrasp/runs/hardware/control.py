"""Runs the pipeline of a scenario on the drivers of a cell, real or simulated."""

import gc
import multiprocessing
import threading
import time
from collections.abc import Callable
from functools import partial
from multiprocessing.synchronize import Event
from typing import Any

import numpy as np
from pydrake.lcm import DrakeLcm

from feasigrasp.errors import HardwareError
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.one_thread import one_thread
from feasigrasp.runs.console import StatusLine, progress
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.runs.results.interrupts import postponed_interrupt
from feasigrasp.runs.run import (
    INTERRUPTED,
    Result,
    crash_record,
    frozen,
    status_history,
    what_failed,
)
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.hardware import channels, guard
from feasigrasp.systems.hardware.control_loop import ControlLoop
from feasigrasp.systems.hardware.guard import GuardedCell, make_guarded_cell
from feasigrasp.systems.hardware.priority import Priority, real_time
from feasigrasp.systems.metrics import SAMPLE_NAMES
from feasigrasp.systems.monitoring.run_log import add_run_log, read_run_log
from feasigrasp.systems.remote.remote_stage import end_processes

#: How long to wait for the guard, or the driver's first message, and then for each message [s].
#: Source: guessed.
WAIT_FOR_DRIVER, SILENCE = 60.0, 5.0
#: How long a controller may ask before somebody commands the arm, by the driver's clock [s].
#: Source: guessed.
WAIT_FOR_GUARD = 2.0


def run_hardware(
    scenario: Scenario,
    name: str,
    lcm_url: str,
    own_guard: bool,
    *,
    log: bool,
    keep: Callable[[dict[str, Any]], None],
    line: StatusLine,
) -> Result:
    """Grasps on the drivers' messages until the grasp is over or the scenario's time has passed.

    A guard, in a process of its own, commands the arm; when this one asks for nothing any more,
    for whatever reason, the guard brakes and the arm stays. Without ``own_guard`` one serves
    already, see `guard`. The drivers are at ``lcm_url``; other arguments are those of `run`. Object
    and motion of the scenario are not looked at.

    Returns:
        A result without samples, with a record whose metrics are None: what happened, only who sees
        the cell reports. Its ``error`` says if there is no driver or guard, or what broke it off.

    Raises:
        HardwareError: There is no such bus, or somebody commands the arm already.
        WorkerError: A process of perception does not start.
    """
    record = crash_record(scenario, name, "")
    error = None
    with one_thread(), frozen(), postponed_interrupt() as interrupted:
        line.show("building the diagram")
        built = time.perf_counter()
        lcm = channels.open_lcm(lcm_url)
        if own_guard:
            guard.refuse_if_commanded(lcm)
        connect = partial(add_run_log, period=scenario.control.period) if log else None
        loop, commands = ControlLoop(scenario, lcm, connect), _Commands(lcm)
        gc.freeze()  # what was built as well: it would be traversed between two ticks
        watch = _OwnGuard(lcm_url, scenario) if own_guard else None
        started = time.perf_counter()
        try:
            line.show("waiting for the arm's driver")
            if watch is not None:
                watch.wait_until_it_serves(interrupted)
            # The last of it `ControlLoop.step` waits, and raises.
            deadline = time.monotonic() + WAIT_FOR_DRIVER - SILENCE
            while loop.intake.oldest() is None and not interrupted.is_set():
                if time.monotonic() > deadline:
                    break
                loop.intake.receive(0.05)
            with real_time(Priority.CONTROL):
                while not interrupted.is_set() and not _is_over(loop, scenario):
                    loop.step(SILENCE)
                    if watch is not None:
                        watch.expect()
                    else:
                        commands.expect(loop.simulator.get_context().get_time())
                    if loop.started:
                        _show(loop, started, line)
        except Exception as failure:
            error = what_failed(failure)
        finally:
            if watch is not None:
                watch.end()
            end_processes(loop.diagram)
    if interrupted.is_set():
        error = INTERRUPTED
    context = loop.simulator.get_context()
    record["timings"] |= {
        "build_s": started - built,
        "wall_s": time.perf_counter() - started,
        "simulated_s": context.get_time(),
    }
    record |= {"error": error, "metrics": dict.fromkeys(METRICS)}
    record |= status_history(loop.diagram, context)
    latencies = loop.image_to_grasps
    record["on_hardware"] = {
        "messages_dropped": dict(loop.intake.dropped),
        "image_to_grasps_ms": 1e3 * float(np.median(latencies)) if latencies else None,
        "image_to_grasps_count": len(latencies),
    }
    keep(record)
    logged = read_run_log(loop.diagram, context) if log else {}
    return Result(record, logged, np.zeros(0), np.zeros((len(SAMPLE_NAMES), 0)))


class _OwnGuard:
    """A guard in a process of its own, which ends when the arm rests after this one has."""

    def __init__(self, lcm_url: str, scenario: Scenario) -> None:
        context = multiprocessing.get_context("spawn")
        self._begun = context.Event()
        given = lcm_url, make_guarded_cell(scenario), self._begun
        self._process = context.Process(target=_serve, args=given)
        self._process.start()

    def wait_until_it_serves(self, interrupted: threading.Event) -> None:
        """Raises if it ends instead, or takes too long; Ctrl-C ends the wait."""
        deadline = time.monotonic() + WAIT_FOR_DRIVER
        while not self._begun.wait(0.1) and not interrupted.is_set():
            self.expect()
            if time.monotonic() > deadline:
                raise HardwareError(f"the arm's guard does not serve after {WAIT_FOR_DRIVER:g} s")

    def expect(self) -> None:
        """Raises if it has ended before its time."""
        if not self._process.is_alive():
            raise HardwareError(
                "the guard that this controller started has ended; see what it said, and start "
                "'feasigrasp run' again"
            )

    def end(self) -> None:
        """Ends it, as soon as the arm rests."""
        self._process.terminate()
        self._process.join()


def _serve(lcm_url: str, cell: GuardedCell, begun: Event) -> None:
    """What its process runs; what is wrong it says without a traceback."""
    try:
        guard.main(lcm_url, begun.set, cell)
    except HardwareError as error:
        raise SystemExit(str(error)) from error


class _Commands:
    """Whether anybody commands the arm."""

    def __init__(self, lcm: DrakeLcm) -> None:
        self._received, self._last = False, 0.0
        self._subscription = channels.subscribe(lcm, channels.IIWA_COMMAND, self._receive)

    def _receive(self, _: bytes) -> None:
        self._received = True

    def expect(self, time_: float) -> None:
        """Raises an error after so long without commands, at a time since the start [s]."""
        if self._received:
            self._received, self._last = False, time_
        if time_ - self._last > WAIT_FOR_GUARD:
            raise HardwareError(
                f"no message on {channels.IIWA_COMMAND} for {WAIT_FOR_GUARD:g} s: no guard does "
                "what this controller asks for; see what 'feasigrasp guard' said, and start it on "
                "the computer of the arm's driver, with the same --lcm-url, or leave out --no-guard"
            )


def _is_over(loop: ControlLoop, scenario: Scenario) -> bool:
    """Whether the grasp is over, or the time is up."""
    context = loop.simulator.get_context()
    sequencer = loop.diagram.GetSubsystemByName("sequencer")
    phase = sequencer.state(sequencer.GetMyContextFromRoot(context)).phase
    return bool(phase == Phase.DONE or context.get_time() >= scenario.simulation_duration)


def _show(loop: ControlLoop, started: float, line: StatusLine) -> None:
    context = loop.simulator.get_context()
    monitor = loop.diagram.GetSubsystemByName("status")
    status = monitor.status(monitor.GetMyContextFromRoot(context))
    line.show(progress(context.get_time(), time.perf_counter() - started, status), patient=True)
