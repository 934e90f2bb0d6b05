"""Violations of velocity and acceleration limits, by the commanded and by the true motion."""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7

#: The true acceleration is the mean over this time [s]. A joint's controller settles in 30 ms or
#: more, so the mean loses little of a motion; the contact solver's noise, which changes its sign
#: from one step of 2.5 ms to the next, has no part in it. Source: reasoned.
WINDOW = 0.02


def limit_metrics(
    sent: Array, velocity: Array, period: float, step: float, arm: Arm = IIWA_7
) -> dict[str, float | None]:
    """Shares of ticks beyond the limits, and the largest values over their limits [%].

    Velocities and accelerations sent are first and second differences of the positions sent, from
    rest on: nothing that says what they should have been is looked at. The true acceleration is
    that of `true_accelerations`.

    Args:
        sent: Desired joint positions, which are what a real arm is sent [rad], shape (m, 7), m > 0.
        velocity: True joint velocities at the rate of the simulation [rad/s], shape (k, 7).
        period: Time between ticks [s].
        step: Time between the true velocities [s].
        arm: The arm.

    Returns:
        ``velocity_limit_violation_percent`` (of ticks by what was sent, or of simulated steps by
        the true motion, the larger share), ``acceleration_limit_violation_percent`` (what was
        sent), ``true_acceleration_violation_percent``, and the largest values
        ``velocity_peak_percent`` (of the true motion), ``acceleration_peak_percent`` (of what was
        sent) and ``true_acceleration_peak_percent``; those of the true acceleration are None for a
        run shorter than `WINDOW`.
    """
    speed = np.abs(velocity) / arm.velocity_limits
    sent_velocity = np.diff(sent, axis=0, prepend=sent[:1]) / period
    sent_speed = np.abs(sent_velocity) / arm.velocity_limits
    change = np.diff(sent_velocity, axis=0, prepend=0.0) / period
    acceleration = np.abs(change) / arm.acceleration_limits
    true = np.abs(true_accelerations(velocity, step)) / arm.acceleration_limits
    return {
        "velocity_limit_violation_percent": max(share_beyond(speed), share_beyond(sent_speed)),
        "acceleration_limit_violation_percent": share_beyond(acceleration),
        "true_acceleration_violation_percent": share_beyond(true) if len(true) else None,
        "velocity_peak_percent": 100.0 * float(speed.max()),
        "acceleration_peak_percent": 100.0 * float(acceleration.max()),
        "true_acceleration_peak_percent": 100.0 * float(true.max()) if len(true) else None,
    }


def true_accelerations(velocity: Array, step: float) -> Array:
    """Mean accelerations over `WINDOW`, ``(v(t + W) - v(t)) / W``, of velocities (k, 7), (n, 7)."""
    lag = max(1, round(WINDOW / step))
    return np.asarray((velocity[lag:] - velocity[:-lag]) / (lag * step))


def share_beyond(ratio: Array) -> float:
    """Percentage of the rows (n, m) of which one entry is beyond 1; 0 without rows."""
    # Positions of 3 rad are rounded to 4e-16 rad, their second differences over 5 ms to
    # 1e-10 rad/s^2: a hundred-thousandth of what may be beyond.
    beyond = np.any(ratio > 1.0 + 1e-6, axis=1)
    return 100.0 * float(np.mean(beyond)) if len(beyond) else 0.0
