"""Computation times of a controller, per tick."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pydrake.systems.framework import LeafSystem

from feasigrasp.systems.grasp_controller import GraspController


class TickTimes:
    """Stops the time of every command and every plan of a controller, the first ones included.

    Systems that are no `GraspController` have neither method; no times are stopped of them.

    Compilation and garbage collection count. Wall time is what an arm waits for; what else runs on
    the machine counts. The thread's processor time is what the tick itself takes.
    """

    def __init__(self, controller: LeafSystem) -> None:
        """Starts to stop the times of ``controller``."""
        self._control, self._control_cpu = _both(controller, "velocity")
        self._planning, self._planning_cpu = _both(controller, "update")

    def metrics(self) -> dict[str, float | None]:
        """``control_ms_p99``, ``control_ms_worst``, ``planning_ms_median``, ``_p99``, ``_worst``.

        And, of processor time, ``control_cpu_ms_worst`` and ``planning_cpu_ms_worst``. None where
        there was no tick.
        """
        return {
            "control_ms_p99": _quantile(self._control, 0.99),
            "control_ms_worst": _quantile(self._control, 1.0),
            "control_cpu_ms_worst": _quantile(self._control_cpu, 1.0),
            "planning_ms_median": _quantile(self._planning, 0.5),
            "planning_ms_p99": _quantile(self._planning, 0.99),
            "planning_ms_worst": _quantile(self._planning, 1.0),
            "planning_cpu_ms_worst": _quantile(self._planning_cpu, 1.0),
        }


def _both(controller: LeafSystem, name: str) -> tuple[list[float], list[float]]:
    """Wall times and processor times of every call of a method from now on [s]."""
    wall: list[float] = []
    cpu: list[float] = []
    method: Callable[..., Any] = getattr(controller, name, lambda: None)

    def timed(*args: Any) -> Any:
        start, cpu_start = time.perf_counter(), time.thread_time()
        try:
            return method(*args)
        finally:
            cpu.append(time.thread_time() - cpu_start)
            wall.append(time.perf_counter() - start)

    if isinstance(controller, GraspController):
        setattr(controller, name, timed)
    return wall, cpu


def _quantile(times: list[float], share: float) -> float | None:
    """In milliseconds."""
    return 1e3 * float(np.quantile(times, share)) if times else None
