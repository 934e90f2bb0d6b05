"""Runs a scenario's pipeline on the drivers of a cell, real or simulated."""

from __future__ import annotations

import gc
import multiprocessing
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np
from pydrake.lcm import DrakeLcm
from threadpoolctl import threadpool_limits

from feasigrasp.errors import HardwareError
from feasigrasp.evaluation.metrics.run_metrics import METRICS
from feasigrasp.evaluation.runs.console import StatusLine, progress
from feasigrasp.evaluation.runs.run import INTERRUPTED, crash_record, status_history
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.results.interrupts import postponed_interrupt
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.hardware import channels, guard
from feasigrasp.systems.hardware.control_loop import ControlLoop
from feasigrasp.systems.hardware.priority import CONTROL, real_time
from feasigrasp.systems.remote.remote_stage import end_processes

#: How long to wait for the driver's first message, and then for each [s].
WAIT_FOR_DRIVER, SILENCE = 60.0, 5.0
#: How long a controller may ask before somebody commands the arm, by the driver's clock [s].
WAIT_FOR_GUARD = 2.0


def run_hardware(
    scenario: Scenario,
    name: str,
    *,
    lcm_url: str = channels.LCM_URL,
    own_guard: bool = True,
    keep: Callable[[dict[str, Any]], None] = lambda record: None,
    line: StatusLine | None = None,
) -> dict[str, Any]:
    """Grasps on the drivers' messages until the grasp is over or the scenario's time has passed.

    A guard, in a process of its own, commands the arm; when this one asks for nothing any more,
    for whatever reason, the guard brakes and the arm stays.

    Args:
        scenario: What to run; object and motion are not looked at.
        name: Its name, for the record.
        lcm_url: Where the drivers are.
        own_guard: Whether to start the guard; else one serves already, see `guard`.
        keep: Gets the record.
        line: Where to say how far the run is.

    Returns:
        A record whose metrics are None: what happened, only who sees the cell can tell. Its
        ``error`` says if there is no driver, or no guard, or one too many.

    Raises:
        HardwareError: There is no such bus.
        WorkerError: A process of perception does not start.
    """
    say = line.show if line else lambda text: None
    record = crash_record(scenario, name, "")
    error = None
    with threadpool_limits(1), postponed_interrupt() as interrupted:
        say("building the diagram")
        built = time.perf_counter()
        lcm = channels.open_lcm(lcm_url)
        loop, commands = ControlLoop(scenario, lcm), _Commands(lcm)
        # What is alive by now stays: not worth traversing again, least of all between two ticks.
        gc.freeze()
        watch = multiprocessing.get_context("spawn").Process(target=_guard, args=(lcm_url,))
        if own_guard:
            watch.start()
        started = time.perf_counter()
        try:
            say("waiting for the arm's driver")
            loop.step(WAIT_FOR_DRIVER)
            with real_time(CONTROL):
                while not interrupted.is_set() and not _is_over(loop, scenario):
                    loop.step(SILENCE)
                    if own_guard:
                        _expect(watch)
                    else:
                        commands.expect(loop.simulator.get_context().get_time())
                    if line is not None and loop.started:
                        _show(loop, started, line)
        except HardwareError as failure:
            error = str(failure)
        finally:
            if own_guard:
                watch.terminate()  # which ends it when the arm rests
                watch.join()
            end_processes(loop.diagram)
    if interrupted.is_set():
        error = INTERRUPTED
    context = loop.simulator.get_context()
    record["timings"] |= {
        "build_s": started - built,
        "wall_s": time.perf_counter() - started,
        "simulated_s": context.get_time(),
    }
    history = status_history(loop.diagram, context)
    status = [[s.time, str(s.code), s.detail] for s in history]
    record |= {"error": error, "status": status, "metrics": dict.fromkeys(METRICS)}
    latencies = loop.image_to_grasps
    record["on_hardware"] = {
        "messages_dropped": dict(loop.intake.dropped),
        "image_to_grasps_ms": 1e3 * float(np.median(latencies)) if latencies else None,
        "image_to_grasps_count": len(latencies),
    }
    keep(record)
    return record


def _guard(lcm_url: str) -> None:
    """What the process of a guard runs; what is wrong it says without a traceback."""
    try:
        guard.main(lcm_url)
    except HardwareError as error:
        raise SystemExit(str(error)) from error


def _expect(watch: BaseProcess) -> None:
    """Raises if a guard has ended before its time."""
    if not watch.is_alive():
        raise HardwareError("the guard that this controller started has ended; see what it said")


class _Commands:
    """Whether anybody commands the arm."""

    def __init__(self, lcm: DrakeLcm) -> None:
        self._heard = False
        self._subscription = lcm.Subscribe(channels.IIWA_COMMAND, self._hear)

    def _hear(self, _: bytes) -> None:
        self._heard = True

    def expect(self, time_: float) -> None:
        """Raises if nobody has, so long after the start [s]."""
        if not self._heard and time_ > WAIT_FOR_GUARD:
            raise HardwareError(
                f"no message on {channels.IIWA_COMMAND} for {WAIT_FOR_GUARD:g} s: no guard does "
                "what this controller asks for; start 'feasigrasp guard' on the computer of the "
                "arm's driver, with the same --lcm-url, or leave out --no-guard"
            )


def _is_over(loop: ControlLoop, scenario: Scenario) -> bool:
    """Whether the grasp is over, or the time is up."""
    context = loop.simulator.get_context()
    sequencer = loop.diagram.GetSubsystemByName("sequencer")
    phase = sequencer.state(sequencer.GetMyContextFromRoot(context)).phase
    return bool(phase == Phase.DONE or context.get_time() >= scenario.simulation_duration)


def _show(loop: ControlLoop, started: float, line: StatusLine) -> None:
    context = loop.simulator.get_context()
    history = status_history(loop.diagram, context)
    line.show(progress(context.get_time(), time.perf_counter() - started, history), patient=True)
