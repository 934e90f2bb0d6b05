"""Aggregates the samples of a run into its metrics."""

import math
from collections.abc import Mapping

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.runs.metrics.cause import Cause, cause_of
from feasigrasp.runs.metrics.handling import (
    ObjectTruth,
    closing_speed,
    contact_metrics,
    displacement_metrics,
    hold_metrics,
)
from feasigrasp.runs.metrics.table import METRICS
from feasigrasp.systems.metrics import SAMPLE_NAMES, SAMPLE_PERIOD

#: A grasp is tracked while the hand is closer to it than this [m], [rad]. Source: definition.
TRACKED_POSITION, TRACKED_ANGLE = 0.015, np.deg2rad(8.0)
#: The share of time tracked is counted after this time [s]: before, the arm is on its way. Source:
#: definition.
SETTLED_AFTER = 2.0
#: The hand has settled if it tracks a grasp this long without a break [s]. Source: definition.
SETTLED_FOR = 0.5
#: A hand that moves on the object farther than this [m], [rad] has taken another grasp; less is the
#: same grasp, known better after another view. Source: definition.
SAME_POSITION, SAME_ANGLE = 0.03, np.deg2rad(30.0)


def tracking_metrics(
    position_error: Array, angle_error: Array, X_OH: Array, following: Mask, period: float
) -> dict[str, float | None]:
    """Figures of the samples in which the hand follows the object with open fingers.

    Args:
        position_error: Distance to the nearest grasp [m], NaN without grasps, shape (n,).
        angle_error: Angle to that grasp [rad], shape (n,).
        X_OH: Pose of the hand on the object, shape (n, 4, 4) [m].
        following: Samples that count: before the fingers close, shape (n,).
        period: Time between samples [s].

    Returns:
        ``tracked_percent``: share of the following samples after `SETTLED_AFTER` in which a grasp
        is tracked; None without such samples. ``settling_time_s``: when the hand first settled;
        None if it never did; a hand that closes its fingers before `SETTLED_FOR` is over has
        settled too. ``grasp_switches``: how often it settled at another grasp than before.
    """
    tracked = following & (position_error < TRACKED_POSITION) & (angle_error < TRACKED_ANGLE)
    late = following & (np.arange(len(tracked)) * period >= SETTLED_AFTER)
    needed = max(1, round(SETTLED_FOR / period))
    first, switches, taken = None, 0, None
    for start, end in _spells(tracked):
        closed = end < len(tracked) and not following[end]
        if end - start < needed and not closed:
            continue
        if first is None:
            first = start * period
        for i in range(start, end):
            if taken is None or not _same(X_OH[taken], X_OH[i]):
                switches += taken is not None
                taken = i
    return {
        "tracked_percent": 100.0 * float(np.mean(tracked[late])) if late.any() else None,
        "settling_time_s": first,
        "grasp_switches": float(switches),
    }


def _spells(true: Mask) -> list[tuple[int, int]]:
    """Start and end (exclusive) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _same(X_OA: Array, X_OB: Array) -> bool:
    X_AB = se3.inverse(X_OA) @ X_OB
    moved = float(np.linalg.norm(X_AB[:3, 3]))
    return moved < SAME_POSITION and float(se3.rotation_angle(X_AB[:3, :3])) < SAME_ANGLE


#: A metric of one run; None where it does not apply.
Value = float | bool | str | None


def summarize(
    samples: Array,
    *,
    closes: bool,
    lift: float = 0.0,
    limits: Mapping[str, float | None] | None = None,
    obstacle_distance: Array | None = None,
    truth: ObjectTruth | None = None,
) -> dict[str, Value]:
    """The metrics of one run; `METRICS` defines every one.

    Args:
        samples: One row per entry of `SAMPLE_NAMES`, one column per sample, shape (s, n).
        closes: Whether the scenario closes the gripper; if not, ``grasp_held`` is None.
        lift: Commanded rise of an object that is held [m]; 0 if there is none.
        limits: Of `limit_metrics`; without them, speeds are those of the samples and there is
            nothing to say about accelerations.
        obstacle_distance: Distance of the arm to its surroundings at some times [m], shape (k,).
        truth: What happened to the object; without it, nothing pushed and nothing touched it.

    Returns:
        A figure for each of `METRICS`; None where it does not apply, and for what they do not
        show: self-collision, torques, tick times, friction, faults of views.
    """
    result: dict[str, Value] = dict.fromkeys(METRICS)
    if samples.shape[1] == 0:
        return result | (not_held(Cause.BROKE_OFF) if closes else {})
    x = dict(zip(SAMPLE_NAMES, samples, strict=True))
    p_HO, p_WO = _vector(x, "p_HO"), _vector(x, "p_WO")
    distance = np.linalg.norm(p_HO, axis=1)
    approach = x["phase"] == Phase.APPROACH
    result |= {
        "joint_limit_violation_percent": 100.0 * float(np.mean(x["limit_margin"] < 0.0)),
        "velocity_limit_violation_percent": 100.0 * float(np.mean(x["velocity_ratio"] > 1.0)),
        "manipulability_mean": float(x["manipulability"].mean()),
        "gripper_object_distance_cm_mean": 100.0 * float(distance.mean()),
        "gripper_object_distance_cm_median": 100.0 * float(np.median(distance)),
        "grasp_position_error_mm_median": _median(x["grasp_position_error"][approach], 1e3),
        "grasp_angle_error_deg_median": _median(
            x["grasp_angle_error"][approach], math.degrees(1.0)
        ),
        "tracked_position_error_mm_median": _median(x["tracked_position_error"][approach], 1e3),
        "limit_margin_min_deg": math.degrees(float(x["limit_margin"].min())),
    }
    X_OH = se3.make_pose(se3.so3_exp(_vector(x, "r_OH")), np.zeros(3))
    X_OH[:, :3, 3] = -np.einsum("nij,nj->ni", X_OH[:, :3, :3], p_HO)
    if not np.isnan(x["reachable_grasps"]).any():  # else grasps are not recorded
        without = np.isnan(x["grasp_position_error"])
        result["no_grasp_percent"] = 100.0 * float(np.mean(without))
        result |= tracking_metrics(
            x["grasp_position_error"], x["grasp_angle_error"], X_OH, approach, SAMPLE_PERIOD
        )
    result |= limits or {}
    if obstacle_distance is not None and len(obstacle_distance):
        nearest = float(np.min(obstacle_distance))
        result["obstacle_distance_min_mm"] = 1e3 * nearest if math.isfinite(nearest) else None
    ages = x["view_age"][approach & (x["reachable_grasps"] > 0)]
    if len(ages := ages[np.isfinite(ages)]):
        result |= {"grasp_age_s_mean": float(ages.mean()), "grasp_age_s_max": float(ages.max())}
    displaced: dict[str, float | None] = {}
    if truth is not None:
        X_WO = se3.make_pose(se3.so3_exp(_vector(x, "r_WO")), p_WO)
        carried = np.arange(len(p_WO)) * SAMPLE_PERIOD <= truth.let_go
        closing = carried & (x["phase"] >= Phase.CLOSE)
        displaced = displacement_metrics(X_WO, truth.path, approach, closing, SAMPLE_PERIOD)
        result |= displaced | contact_metrics(truth.contact)
        result["closing_speed_m_s"] = closing_speed(truth.path, x["phase"], SAMPLE_PERIOD)
    if closes:
        hold = hold_metrics(se3.inverse(X_OH), p_WO, x["phase"], SAMPLE_PERIOD, lift)
        result |= hold
        if not hold["grasp_held"] or (truth is not None and truth.broke_off):
            slip = 1e-3 * (hold["slip_mm"] or 0.0), math.radians(hold["turn_deg"] or 0.0)
            result |= not_held(cause_of(x, truth, displaced.get("pushed_mm"), slip))
    for axis, value in zip("xyz", p_WO[-1], strict=True):
        result[f"object_end_{axis}_m"] = float(value)
    return result


def not_held(cause: Cause) -> dict[str, Value]:
    """Metrics of an object that was not held."""
    return {"grasp_held": False, "held_after_s": None, "cause": str(cause)}


def _vector(x: dict[str, Array], name: str) -> Array:
    return np.stack([x[f"{name}_{axis}"] for axis in "xyz"], axis=1)


def _median(values: Array, factor: float) -> float | None:
    values = values[np.isfinite(values)]
    return factor * float(np.median(values)) if len(values) else None
