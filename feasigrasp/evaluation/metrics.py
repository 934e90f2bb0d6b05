"""Sums up the samples of a run into the figures of the dynamic test."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.grasp_sequence import Phase
from feasigrasp.systems.metrics import SAMPLE_NAMES

FloatArray = NDArray[np.float64]

#: An object that stays this close to where it was in the hand counts as held [m].
HELD_TOLERANCE = 0.02


@dataclass(frozen=True)
class Metric:
    """What is known of a metric beforehand.

    Attributes:
        unit: Its unit; ``bool`` for what is true or false.
        lower: Its smallest possible value.
        upper: Its largest possible value.
    """

    unit: str
    lower: float = -math.inf
    upper: float = math.inf


#: Every metric of a run, in the order of the record.
METRICS: dict[str, Metric] = {
    "self_collision_percent": Metric("%", 0.0, 100.0),
    "joint_limit_violation_percent": Metric("%", 0.0, 100.0),
    "velocity_limit_violation_percent": Metric("%", 0.0, 100.0),
    "manipulability_mean": Metric("m^3", 0.0),
    "gripper_object_distance_cm_mean": Metric("cm", 0.0),
    "gripper_object_distance_cm_median": Metric("cm", 0.0),
    "grasp_position_error_mm_median": Metric("mm", 0.0),
    "grasp_angle_error_deg_median": Metric("deg", 0.0, 180.0),
    "no_grasp_percent": Metric("%", 0.0, 100.0),
    "self_distance_min_mm": Metric("mm"),
    "limit_margin_min_deg": Metric("deg"),
    "grasp_held": Metric("bool"),
    "slip_mm": Metric("mm", 0.0),
    "lift_cm": Metric("cm"),
    "object_end_x_m": Metric("m"),
    "object_end_y_m": Metric("m"),
    "object_end_z_m": Metric("m"),
}


def _median(values: FloatArray) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None


def summarize(samples: FloatArray, *, closes: bool) -> dict[str, float | bool | None]:
    """The metrics of one run; ``docs/results_schema.md`` defines every one.

    Args:
        samples: One row per entry of `SAMPLE_NAMES`, one column per sample, shape (s, n).
        closes: Whether the scenario closes the gripper; if not, ``grasp_held`` is None.

    Returns:
        A figure for each of `METRICS`; None where it does not apply.
    """
    if samples.shape[1] == 0:
        return dict.fromkeys(METRICS) | {"grasp_held": False if closes else None}
    x = dict(zip(SAMPLE_NAMES, samples, strict=True))
    p_HO = np.stack([x["p_HO_x"], x["p_HO_y"], x["p_HO_z"]])
    p_WO = np.stack([x["p_WO_x"], x["p_WO_y"], x["p_WO_z"]])
    distance = np.linalg.norm(p_HO, axis=0)
    approach = x["phase"] == Phase.APPROACH
    released = x["phase"] > Phase.CLOSE
    result: dict[str, float | bool | None] = {
        "self_collision_percent": 100.0 * float(np.mean(x["self_collision"])),
        "joint_limit_violation_percent": 100.0 * float(np.mean(x["limit_margin"] < 0.0)),
        "velocity_limit_violation_percent": 100.0 * float(np.mean(x["velocity_ratio"] > 1.0)),
        "manipulability_mean": float(x["manipulability"].mean()),
        "gripper_object_distance_cm_mean": 100.0 * float(distance.mean()),
        "gripper_object_distance_cm_median": 100.0 * float(np.median(distance)),
        "grasp_position_error_mm_median": _scaled(
            _median(x["grasp_position_error"][approach]), 1e3
        ),
        "grasp_angle_error_deg_median": _scaled(
            _median(x["grasp_angle_error"][approach]), math.degrees(1.0)
        ),
        "no_grasp_percent": 100.0 * float(np.mean(np.isnan(x["grasp_position_error"]))),
        "self_distance_min_mm": 1e3 * float(x["self_distance"].min()),
        "limit_margin_min_deg": math.degrees(float(x["limit_margin"].min())),
        "grasp_held": None,
        "slip_mm": None,
        "lift_cm": None,
    }
    if closes:
        result["grasp_held"] = False
        if released.any():
            start = int(np.argmax(released))
            slip = np.linalg.norm(p_HO[:, start:] - p_HO[:, start, None], axis=0)
            result["slip_mm"] = 1e3 * float(slip.max())
            result["lift_cm"] = 100.0 * float(p_WO[2, -1] - p_WO[2, start])
            done = bool(x["phase"][-1] == Phase.DONE)
            result["grasp_held"] = done and float(slip.max()) < HELD_TOLERANCE
    for axis, value in zip("xyz", p_WO[:, -1], strict=True):
        result[f"object_end_{axis}_m"] = float(value)
    return result


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
