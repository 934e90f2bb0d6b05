"""Self-collision and joint-torque metrics, by the independent reference model."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.runs.metrics.reference_robot import ReferenceRobot

#: Largest self-distance that is computed [m].
NEAR = 0.05
#: Torques are clamped at their limits, so what comes this near has reached them (relative).
_ROUNDING = 1e-6
#: Forearm and flange: the one turns in the other's fork, 3.6 cm away for most of the way.
_FORK = {IIWA_7.link_names[5], IIWA_7.link_names[7]}


def self_collision_metrics(reference: ReferenceRobot, Q: Array) -> dict[str, float | None]:
    """``self_collision_percent`` and ``self_distance_min_mm`` of joint positions (n, 7) [rad].

    The distance is None where it never falls below `NEAR`; that of the forearm and the flange does
    not count as one.
    """
    distances = reference.self_distances(Q, NEAR)
    names = [{reference.names[a], reference.names[b]} for a, b in reference.pairs]
    checked = distances[:, [pair != _FORK for pair in names]]
    nearest = float(checked.min(initial=np.inf))
    return {
        "self_collision_percent": 100.0 * float(np.mean((distances < 0.0).any(axis=1))),
        "self_distance_min_mm": 1e3 * nearest if np.isfinite(nearest) else None,
    }


def torque_metrics(
    reference: ReferenceRobot, Q: Array, actuation: Array
) -> dict[str, float | None]:
    """``torque_limit_violation_percent`` and ``torque_peak_percent``.

    The simulated arm is weightless, a real one is not: what its motors would bear is the simulated
    actuation and the weight of arm, hand and camera.

    Args:
        reference: Model with the weight.
        Q: Joint positions, shape (m, 7) [rad].
        actuation: Torques of the simulated motors at the same times, shape (m, 7) [Nm].
    """
    share = np.abs(actuation + reference.gravity_torques(Q)) / IIWA_7.effort_limits
    clamped = np.abs(actuation) / IIWA_7.effort_limits
    beyond = np.maximum(share, clamped) >= 1.0 - _ROUNDING
    return {
        "torque_limit_violation_percent": 100.0 * float(np.mean(beyond.any(axis=1))),
        "torque_peak_percent": 100.0 * float(share.max()),
    }
