"""Sums up the samples of a run into the figures of the dynamic test."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from feasigrasp.evaluation.runs.cause import Cause, Course, cause_of
from feasigrasp.evaluation.runs.grasp_tracking import tracking_metrics
from feasigrasp.evaluation.runs.handling import contact_metrics, hold_metrics, pushed_metrics
from feasigrasp.evaluation.runs.motion_limits import JointTicks, limit_metrics
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.systems.metrics import SAMPLE_NAMES, SAMPLE_PERIOD


@dataclass(frozen=True)
class Metric:
    """What is known of a metric beforehand.

    Attributes:
        unit: Its unit; ``bool`` for what is true or false, ``text`` for what is a word.
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
    "acceleration_limit_violation_percent": Metric("%", 0.0, 100.0),
    "manipulability_mean": Metric("m^3", 0.0),
    "gripper_object_distance_cm_mean": Metric("cm", 0.0),
    "gripper_object_distance_cm_median": Metric("cm", 0.0),
    "grasp_position_error_mm_median": Metric("mm", 0.0),
    "grasp_angle_error_deg_median": Metric("deg", 0.0, 180.0),
    "tracked_percent": Metric("%", 0.0, 100.0),
    "settling_time_s": Metric("s", 0.0),
    "grasp_switches": Metric("1", 0.0),
    "no_grasp_percent": Metric("%", 0.0, 100.0),
    "self_distance_min_mm": Metric("mm"),
    "limit_margin_min_deg": Metric("deg"),
    "velocity_peak_percent": Metric("%", 0.0),
    "acceleration_peak_percent": Metric("%", 0.0),
    "obstacle_distance_min_mm": Metric("mm"),
    "friction": Metric("1", 0.0),
    "view_faults": Metric("1", 0.0),
    "grasp_age_s_mean": Metric("s", 0.0),
    "grasp_age_s_max": Metric("s", 0.0),
    "pushed_mm": Metric("mm", 0.0),
    "pushed_deg": Metric("deg", 0.0, 180.0),
    "contact_force_peak_n": Metric("N", 0.0),
    "contact_time_percent": Metric("%", 0.0, 100.0),
    "grasp_held": Metric("bool"),
    "cause": Metric("text"),
    "slip_mm": Metric("mm", 0.0),
    "turn_deg": Metric("deg", 0.0, 180.0),
    "lift_cm": Metric("cm"),
    "object_end_x_m": Metric("m"),
    "object_end_y_m": Metric("m"),
    "object_end_z_m": Metric("m"),
}


#: A metric of one run; None where it does not apply.
Value = float | bool | str | None


@dataclass(frozen=True, eq=False)
class RunFacts:
    """What is known of a run beside its samples; None and NaN where nobody looked.

    Attributes:
        ticks: Joint velocities at the control rate; without them, speeds are those of the samples
            and there is nothing to say about accelerations.
        obstacle_distance: Distance of the arm to its surroundings at some times [m], shape (k,).
        path: Where its motion would have the object at every sample, shape (n, 4, 4).
        contact: What `feasigrasp.systems.station.object_contact.ObjectContact` says at the end.
        touched: Whether arm or hand touched the object at the end.
        broke_off: Whether the simulation failed.
        friction: Coulomb friction of pads and object.
        view_faults: Views that could not be used.
    """

    ticks: JointTicks | None = None
    obstacle_distance: Array | None = None
    path: Array | None = None
    contact: Array | None = None
    touched: bool = False
    broke_off: bool = False
    friction: float | None = None
    view_faults: float | None = None


def summarize(samples: Array, *, closes: bool, facts: RunFacts | None = None) -> dict[str, Value]:
    """The metrics of one run; ``docs/results_schema.md`` defines every one.

    Args:
        samples: One row per entry of `SAMPLE_NAMES`, one column per sample, shape (s, n).
        closes: Whether the scenario closes the gripper; if not, ``grasp_held`` is None.
        facts: What else is known of the run.

    Returns:
        A figure for each of `METRICS`; None where it does not apply.
    """
    facts = RunFacts() if facts is None else facts
    result: dict[str, Value] = dict.fromkeys(METRICS)
    result |= {"friction": facts.friction, "view_faults": facts.view_faults}
    if samples.shape[1] == 0:
        return result | (not_held(Cause.BROKE_OFF) if closes else {})
    x = dict(zip(SAMPLE_NAMES, samples, strict=True))
    p_HO, p_WO = _vector(x, "p_HO"), _vector(x, "p_WO")
    distance = np.linalg.norm(p_HO, axis=1)
    approach = x["phase"] == Phase.APPROACH
    result |= {
        "self_collision_percent": 100.0 * float(np.mean(x["self_collision"])),
        "joint_limit_violation_percent": 100.0 * float(np.mean(x["limit_margin"] < 0.0)),
        "velocity_limit_violation_percent": 100.0 * float(np.mean(x["velocity_ratio"] > 1.0)),
        "manipulability_mean": float(x["manipulability"].mean()),
        "gripper_object_distance_cm_mean": 100.0 * float(distance.mean()),
        "gripper_object_distance_cm_median": 100.0 * float(np.median(distance)),
        "grasp_position_error_mm_median": _median(x["grasp_position_error"][approach], 1e3),
        "grasp_angle_error_deg_median": _median(
            x["grasp_angle_error"][approach], math.degrees(1.0)
        ),
        "no_grasp_percent": 100.0 * float(np.mean(np.isnan(x["grasp_position_error"]))),
        "self_distance_min_mm": 1e3 * float(x["self_distance"].min()),
        "limit_margin_min_deg": math.degrees(float(x["limit_margin"].min())),
    }
    X_OH = se3.make_pose(se3.so3_exp(_vector(x, "r_OH")), np.zeros(3))
    X_OH[:, :3, 3] = -np.einsum("nij,nj->ni", X_OH[:, :3, :3], p_HO)
    result |= tracking_metrics(
        x["grasp_position_error"], x["grasp_angle_error"], X_OH, approach, SAMPLE_PERIOD
    )
    if facts.ticks is not None and len(facts.ticks.commanded):
        result |= limit_metrics(facts.ticks)
    if facts.obstacle_distance is not None and len(facts.obstacle_distance):
        nearest = float(np.min(facts.obstacle_distance))
        result["obstacle_distance_min_mm"] = 1e3 * nearest if math.isfinite(nearest) else None
    ages = x["view_age"][approach & (x["reachable_grasps"] > 0)]
    if np.isfinite(ages).any():
        result["grasp_age_s_mean"] = float(np.nanmean(ages))
        result["grasp_age_s_max"] = float(np.nanmax(ages))
    if facts.path is not None:
        X_WO = se3.make_pose(se3.so3_exp(_vector(x, "r_WO")), p_WO)
        result |= pushed_metrics(X_WO, facts.path, approach, SAMPLE_PERIOD)
    if facts.contact is not None:
        result |= contact_metrics(facts.contact)
    if closes:
        result |= hold_metrics(se3.inverse(X_OH), x["phase"], SAMPLE_PERIOD)
        released = x["phase"] > Phase.CLOSE
        if released.any():
            start = int(np.argmax(released))
            result["lift_cm"] = 100.0 * float(p_WO[-1, 2] - p_WO[start, 2])
        if facts.broke_off or not result["grasp_held"]:
            pushed = result["pushed_mm"] or 0.0
            result |= not_held(cause_of(Course(x, pushed, facts.touched, facts.broke_off)))
    for axis, value in zip("xyz", p_WO[-1], strict=True):
        result[f"object_end_{axis}_m"] = float(value)
    return result


def not_held(cause: Cause) -> dict[str, Value]:
    """What the metrics say of an object that was not held."""
    return {"grasp_held": False, "cause": str(cause)}


def _vector(x: dict[str, Array], name: str) -> Array:
    return np.stack([x[f"{name}_{axis}"] for axis in "xyz"], axis=1)


def _median(values: Array, factor: float) -> float | None:
    values = values[np.isfinite(values)]
    return factor * float(np.median(values)) if len(values) else None
