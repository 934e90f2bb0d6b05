"""How long a controller takes, tick by tick."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from feasigrasp.systems.grasp_controller import GraspController


class TickTimes:
    """Stops the time of every command and every plan of a controller, the first ones included.

    It is wall time: what else runs on the machine counts, as it does for an arm that waits.
    """

    def __init__(self, controller: GraspController) -> None:
        """Starts to stop the times of ``controller``."""
        self._control = times_of(controller, "velocity", time.perf_counter)
        self._planning = times_of(controller, "update", time.perf_counter)

    def metrics(self) -> dict[str, float | None]:
        """``control_ms_p99``, ``control_ms_worst``, ``planning_ms_median``, ``_p99``, ``_worst``.

        None where there was no tick.
        """
        control, planning = 1e3 * np.array(self._control), 1e3 * np.array(self._planning)
        return {
            "control_ms_p99": _quantile(control, 0.99),
            "control_ms_worst": _quantile(control, 1.0),
            "planning_ms_median": _quantile(planning, 0.5),
            "planning_ms_p99": _quantile(planning, 0.99),
            "planning_ms_worst": _quantile(planning, 1.0),
        }


def times_of(controller: GraspController, name: str, clock: Callable[[], float]) -> list[float]:
    """A list that gets how long every call of a controller's method takes from now on.

    Args:
        controller: The controller.
        name: ``velocity`` or ``update``.
        clock: What the time is [s].
    """
    times: list[float] = []
    method: Callable[..., Any] = getattr(controller, name)

    def timed(*args: Any) -> Any:
        start = clock()
        try:
            return method(*args)
        finally:
            times.append(clock() - start)

    setattr(controller, name, timed)
    return times


def _quantile(values: np.ndarray, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None
