"""Violations of velocity and acceleration limits by the commanded positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7

#: What a motion exactly at a limit may go beyond it, relative to the limit. Positions of 3 rad are
#: rounded to 4e-16 rad, their second differences over 5 ms to 1e-10 rad/s^2: a hundred-thousandth
#: of this.
ROUNDING = 1e-6
#: Half the window over which the true acceleration is taken [s].
WINDOW = 0.02


@dataclass(frozen=True, eq=False)
class JointTicks:
    """Commands and states of the arm at every control tick.

    Attributes:
        sent: Desired joint positions, which are what a real arm is sent [rad], shape (m, 7).
        position: True joint positions [rad], shape (m, 7).
        velocity: True joint velocities [rad/s], shape (m, 7).
        period: Time between ticks [s].
    """

    sent: Array
    position: Array
    velocity: Array
    period: float


def limit_metrics(ticks: JointTicks) -> dict[str, float | None]:
    """Shares of ticks beyond the limits, and the largest values over their limits [%].

    Velocities and accelerations sent are first and second differences of the positions sent, from
    rest on: nothing that says what they should have been is looked at. The true acceleration is a
    second difference of the true positions over `WINDOW` to either side.

    Args:
        ticks: At least one tick.

    Returns:
        ``velocity_limit_violation_percent`` (what was sent *or* the true motion),
        ``acceleration_limit_violation_percent`` (what was sent), ``velocity_peak_percent`` (of the
        true motion), ``acceleration_peak_percent`` (of what was sent) and
        ``true_acceleration_peak_percent``; the last None for a run shorter than its window.
    """
    speed = np.abs(ticks.velocity) / IIWA_7.velocity_limits
    velocity = np.diff(ticks.sent, axis=0, prepend=ticks.sent[:1]) / ticks.period
    largest = np.maximum(speed, np.abs(velocity) / IIWA_7.velocity_limits)
    change = np.diff(velocity, axis=0, prepend=0.0) / ticks.period
    acceleration = np.abs(change) / IIWA_7.acceleration_limits
    true = true_accelerations(ticks.position, ticks.period) / IIWA_7.acceleration_limits
    return {
        "velocity_limit_violation_percent": _share_beyond(largest),
        "acceleration_limit_violation_percent": _share_beyond(acceleration),
        "velocity_peak_percent": 100.0 * float(speed.max()),
        "acceleration_peak_percent": 100.0 * float(acceleration.max()),
        "true_acceleration_peak_percent": 100.0 * float(np.abs(true).max()) if len(true) else None,
    }


def true_accelerations(position: Array, period: float) -> Array:
    """Second differences of positions (m, 7) over `WINDOW`, at the ticks that have one, (n, 7).

    It is the mean of the acceleration over twice the window, the middle weighted most.
    """
    lag = max(1, round(WINDOW / period))
    near, far = position[lag:-lag], position[2 * lag :] + position[: -2 * lag]
    return np.asarray((far - 2.0 * near) / (lag * period) ** 2)


def _share_beyond(ratio: Array) -> float:
    return 100.0 * float(np.mean(np.any(ratio > 1.0 + ROUNDING, axis=1)))
