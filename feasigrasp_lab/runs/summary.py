"""Figures of many runs: the rows of ``evaluate dynamic``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.models.control.mode import ControlMode
from feasigrasp.runs.metrics.run_metrics import METRICS, Metric
from feasigrasp.runs.results.rows import Row
from feasigrasp.runs.results.statistics import grouped, mean_of_objects, share_of_objects
from feasigrasp_lab.protocols.ablations import ablation_rows
from feasigrasp_lab.protocols.speed import curve_point
from feasigrasp_lab.runs.studies import suffix_of

Record = dict[str, Any]

#: An object that is this far off its path before the fingers close was pushed [mm].
PUSHED_MM = 5.0
#: Figures of the printed table: column head, row name.
_COLUMNS = (
    ("held %", "held_percent"),
    ("pushed %", "pushed_percent"),
    ("contact %", "contact_before_closing_percent"),
    ("q limits %", "joint_limit_violation_percent"),
    ("v limits %", "velocity_limit_violation_percent"),
    ("a limits %", "acceleration_limit_violation_percent"),
    ("torques %", "torque_limit_violation_percent"),
    ("self-coll. %", "self_collision_percent"),
    ("dist. cm", "gripper_object_distance_cm_mean"),
    ("tracked %", "tracked_percent"),
    ("planning ms", "planning_ms.worst"),
    ("x real time", "real_time_factor"),
)
#: Figures that are told for every object as well: those of the paper's table, the errors to the
#: nearest grasp, and what happened to the object.
_PER_OBJECT = (
    "self_collision_percent",
    "joint_limit_violation_percent",
    "manipulability_mean",
    "gripper_object_distance_cm_mean",
    "grasp_position_error_mm_median",
    "grasp_angle_error_deg_median",
    "tracked_percent",
)
#: Shares of runs: row name, and whether it is so in a run; None where it does not apply.
_SHARES: dict[str, Callable[[Record], bool | None]] = {
    "held_percent": lambda run: run["metrics"]["grasp_held"],
    "failed_percent": lambda run: run["error"] is not None,
    "pushed_percent": lambda run: _exceeds(run, "pushed_mm", PUSHED_MM),
    "contact_before_closing_percent": lambda run: _exceeds(run, "contact_force_peak_n", 0.0),
}
#: Figures that a mean would hide: row name, metric, and what is taken of the runs.
_OVER_RUNS: tuple[tuple[str, str, Callable[[Sequence[float]], Any]], ...] = (
    ("pushed_mm_max", "pushed_mm", max),
    ("obstacle_distance_min_mm.least", "obstacle_distance_min_mm", min),
    ("self_distance_min_mm.least", "self_distance_min_mm", min),
    ("torque_peak_percent.worst", "torque_peak_percent", max),
    ("control_ms.p99", "control_ms_p99", np.median),
    ("control_ms.worst", "control_ms_worst", max),
    ("control_cpu_ms.worst", "control_cpu_ms_worst", max),
    ("planning_ms.median", "planning_ms_median", np.median),
    ("planning_ms.p99", "planning_ms_p99", np.median),
    ("planning_ms.worst", "planning_ms_worst", max),
    ("planning_cpu_ms.worst", "planning_cpu_ms_worst", max),
)
#: Metrics that have no row of their mean.
_NOT_AVERAGED = (
    *("grasp_held", "cause", "object_end_x_m", "object_end_y_m", "object_end_z_m"),
    *("control_ms_p99", "control_ms_worst", "control_cpu_ms_worst"),
    *("planning_ms_median", "planning_ms_p99", "planning_ms_worst", "planning_cpu_ms_worst"),
)


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Figures per scenario and controller, per controller, and over all runs.

    Presets are ``<scenario>/<controller>/<mode>``, with ``all`` (and the suffix of a study) where
    runs are put together, ``<motion>/<m/s>`` for the points of the speed curve, and
    ``<scenario>/<controller>/<mode>/<object>`` for single objects if there are several. In means
    and shares every object counts once, and their intervals come from drawing the objects anew; a
    figure that no run of a group has is left out. Ablations are compared with the runs of the whole
    (`ablation_rows`).

    Args:
        records: Records of runs.
    """
    causes = sorted({run["metrics"].get("cause") for run in records} - {None})
    presets = ("{scenario}/{controller}/{mode}", "{all}/{controller}/{mode}", "{all}/all/{mode}")
    rows = []
    for preset, group in (_groups(records, *presets) | _curves(records)).items():
        rows += _group_rows(preset, group, causes)
    if len({run["object"] for run in records}) > 1:
        for preset, group in _groups(records, "{scenario}/{controller}/{mode}/{stem}").items():
            rows += _share_rows(preset, group)
            for name in _PER_OBJECT:
                rows += _mean_row(name, preset, group)
    return rows + ablation_rows(records)


def _groups(records: Sequence[Record], *presets: str) -> dict[str, list[Record]]:
    """The records by preset; ``{stem}`` is the name of the object, without folder and suffix."""
    groups: dict[str, list[Record]] = {}
    for preset in presets:
        for record in records:
            names = {"stem": Path(record["object"]).stem}
            names["all"] = f"all{suffix_of(record['scenario'])}"
            groups.setdefault(preset.format_map(record | names), []).append(record)
    return groups


def _curves(records: Sequence[Record]) -> dict[str, list[Record]]:
    """The records of the points of curves, ``<motion>/<m/s>``, whatever the controller.

    Of several modes only `ControlMode.SAFE` is in them.
    """
    modes = {record["mode"] for record in records}
    of_one = [record for record in records if len(modes) == 1 or record["mode"] == ControlMode.SAFE]
    points = grouped(of_one, lambda record: curve_point(record["scenario"]))
    return {point: group for point, group in points.items() if point is not None}


def _group_rows(preset: str, records: Sequence[Record], causes: Sequence[str]) -> list[Row]:
    rows = _share_rows(preset, records) + _cause_rows(preset, records, causes)
    for name in (*METRICS, "real_time_factor"):
        if name not in _NOT_AVERAGED:
            rows += _mean_row(name, preset, records)
    for row_name, metric, reduce in _OVER_RUNS:
        values = [value for value, _ in _present(metric, records)]
        if values:
            name, unit = f"dynamic.{row_name}", METRICS.get(metric, Metric("1")).unit
            rows.append(Row.plain(name, preset, reduce(values), unit, len(values)))
    return rows


def _share_rows(preset: str, records: Sequence[Record]) -> list[Row]:
    """How many percent of the runs held, failed, pushed or touched their object."""
    rows = []
    for name, is_so in _SHARES.items():
        found = [(so, run["object"]) for run in records if (so := is_so(run)) is not None]
        if found:
            rows.append(_percent(name, preset, *zip(*found, strict=True)))
    return rows


def _cause_rows(preset: str, records: Sequence[Record], causes: Sequence[str]) -> list[Row]:
    """Of the runs that close the hand, how many percent did not hold for each reason."""
    closing = [run for run in records if run["metrics"]["grasp_held"] is not None]
    objects = [run["object"] for run in closing]
    return [
        _percent(
            f"cause.{cause}_percent",
            preset,
            [run["metrics"]["cause"] == cause for run in closing],
            objects,
        )
        for cause in causes
        if closing
    ]


def _mean_row(name: str, preset: str, records: Sequence[Record]) -> list[Row]:
    """The mean of a metric, or of a timing, over the records that have it."""
    present = _present(name, records)
    if not present:
        return []
    values, objects = zip(*present, strict=True)
    metric = METRICS.get(name, Metric("1", 0.0))
    estimate = mean_of_objects(values, objects, metric.lower, metric.upper)
    return [Row.of(f"dynamic.{name}", preset, estimate, metric.unit)]


def _present(name: str, records: Sequence[Record]) -> list[tuple[float, str]]:
    """A metric or timing of the records that have it, with their objects."""
    found = [((r["metrics"] | r["timings"]).get(name), r["object"]) for r in records]
    return [(float(value), each) for value, each in found if value is not None]


def _percent(name: str, preset: str, outcomes: Sequence[bool], objects: Sequence[str]) -> Row:
    return Row.of(f"dynamic.{name}", preset, share_of_objects(outcomes, objects), "%", 100.0)


def _exceeds(run: Record, name: str, limit: float) -> bool | None:
    value = run["metrics"].get(name)
    return None if value is None else value > limit


def format_table(rows: Sequence[Row]) -> str:
    """The main figures as text, one line per preset; the interval of ``held %`` in brackets."""
    found = {(row.preset, row.name.removeprefix("dynamic.")): row for row in rows}
    presets = [p for p in dict.fromkeys(row.preset for row in rows) if p.count("/") == 2]
    columns = [c for c in _COLUMNS if any((preset, c[1]) in found for preset in presets)]
    width = max(len(preset) for preset in presets)
    lines = [f"{'':{width}s} " + "".join(f"{head:>14s}" for head, _ in columns) + f"{'runs':>6s}"]
    for preset in presets:
        cells = []
        for _, name in columns:
            row = found.get((preset, name))
            text = "-" if row is None else f"{row.value:.3g}"
            if row is not None and row.low is not None and name == "held_percent":
                text += f" [{row.low:.0f}, {row.high:.0f}]"
            cells.append(f"{text:>14s}")
        runs = found[preset, "failed_percent"].n
        lines.append(f"{preset:{width}s} {''.join(cells)}{runs:6d}")
    return "\n".join(lines)
