"""Whether the arm kept its velocity and acceleration limits, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7

#: Rounding of a command that sits exactly at its limit is no violation.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class JointTicks:
    """What the arm was told and what it did, at every tick of the control.

    Attributes:
        commanded: Joint velocities sent to the arm [rad/s], shape (m, 7).
        measured: True joint velocities [rad/s], shape (m, 7).
        period: Time between ticks [s].
    """

    commanded: Array
    measured: Array
    period: float


def limit_metrics(ticks: JointTicks) -> dict[str, float | None]:
    """Shares of ticks beyond the limits, and the largest values over their limits [%].

    A velocity counts as violating if it is too large in the command *or* in the true motion. An
    acceleration is that of the command, ``(v_k - v_(k-1)) / period``: it is what the arm's own
    controller is asked for. The true one is no measure of a controller: the simulated arm answers
    each step of the command within one or two steps of the physics, so that differences of its
    velocity show the time step.

    Args:
        ticks: At least one tick.

    Returns:
        ``velocity_limit_violation_percent``, ``acceleration_limit_violation_percent``,
        ``velocity_peak_percent`` (of the true motion), ``acceleration_peak_percent``; the
        accelerations None for a single tick.
    """
    speed = np.abs(ticks.measured) / IIWA_7.velocity_limits
    largest = np.maximum(speed, np.abs(ticks.commanded) / IIWA_7.velocity_limits)
    change = np.abs(np.diff(ticks.commanded, axis=0)) / ticks.period / IIWA_7.acceleration_limits
    return {
        "velocity_limit_violation_percent": _share_beyond(largest),
        "acceleration_limit_violation_percent": _share_beyond(change) if len(change) else None,
        "velocity_peak_percent": 100.0 * float(speed.max()),
        "acceleration_peak_percent": 100.0 * float(change.max()) if len(change) else None,
    }


def _share_beyond(ratio: Array) -> float:
    return 100.0 * float(np.mean(np.any(ratio > 1.0 + _ROUNDING, axis=1)))
