"""Figures of many runs: the rows of ``evaluate dynamic``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from feasigrasp.evaluation.runs.run_metrics import METRICS, Metric
from feasigrasp.results.rows import Row
from feasigrasp.results.statistics import mean, proportion

Record = dict[str, Any]

#: Figures of the printed table: column head, row name.
_COLUMNS = (
    ("held %", "dynamic.held_percent"),
    ("q limits %", "dynamic.joint_limit_violation_percent"),
    ("v limits %", "dynamic.velocity_limit_violation_percent"),
    ("a limits %", "dynamic.acceleration_limit_violation_percent"),
    ("self-coll. %", "dynamic.self_collision_percent"),
    ("manipulab.", "dynamic.manipulability_mean"),
    ("dist. cm", "dynamic.gripper_object_distance_cm_mean"),
    ("tracked %", "dynamic.tracked_percent"),
    ("x real time", "dynamic.real_time_factor"),
)
#: Figures that are told for every object as well: those of the paper's table, and the errors to the
#: nearest grasp.
_PER_OBJECT = (
    "self_collision_percent",
    "joint_limit_violation_percent",
    "manipulability_mean",
    "gripper_object_distance_cm_mean",
    "grasp_position_error_mm_median",
    "grasp_angle_error_deg_median",
    "tracked_percent",
)
_NOT_AVERAGED = ("grasp_held", "cause", "object_end_x_m", "object_end_y_m", "object_end_z_m")


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Figures per scenario and controller, per controller, and over all runs.

    Presets are ``<scenario>/<controller>/<mode>``, with ``all`` where runs are put together, and
    ``<scenario>/<controller>/<mode>/<object>`` for single objects if there are several.
    Shares of runs have Wilson intervals, means over runs Student's; a figure that no run of a
    group has is left out.

    Args:
        records: Records of runs.
    """
    presets = ("{scenario}/{controller}/{mode}", "all/{controller}/{mode}", "all/all/{mode}")
    rows = [row for group in _groups(records, *presets).items() for row in _group_rows(*group)]
    if len({Path(record["object"]).stem for record in records}) > 1:
        for preset, group in _groups(records, "{scenario}/{controller}/{mode}/{stem}").items():
            for name in _PER_OBJECT:
                rows += _mean_row(name, preset, group)
    return rows


def _groups(records: Sequence[Record], *presets: str) -> dict[str, list[Record]]:
    """The records by preset; ``{stem}`` is the name of the object, without folder and suffix."""
    groups: dict[str, list[Record]] = {}
    for preset in presets:
        for record in records:
            name = preset.format_map(record | {"stem": Path(record["object"]).stem})
            groups.setdefault(name, []).append(record)
    return groups


def _group_rows(preset: str, records: Sequence[Record]) -> list[Row]:
    rows = []
    held = [r["metrics"]["grasp_held"] for r in records if r["metrics"]["grasp_held"] is not None]
    if held:
        estimate = proportion(sum(held), len(held))
        rows.append(Row.of("dynamic.held_percent", preset, estimate, "%", 100.0))
    failed = proportion(sum(r["error"] is not None for r in records), len(records))
    rows.append(Row.of("dynamic.failed_percent", preset, failed, "%", 100.0))
    for name in (*METRICS, "real_time_factor"):
        if name not in _NOT_AVERAGED:
            rows += _mean_row(name, preset, records)
    return rows


def _mean_row(name: str, preset: str, records: Sequence[Record]) -> list[Row]:
    """The mean of a metric, or of a timing, over the records that have it."""
    values = [(r["metrics"] | r["timings"])[name] for r in records]
    present = [value for value in values if value is not None]
    if not present:
        return []
    metric = METRICS.get(name, Metric("1", 0.0))
    estimate = mean(present, metric.lower, metric.upper)
    return [Row.of(f"dynamic.{name}", preset, estimate, metric.unit)]


def format_table(rows: Sequence[Row]) -> str:
    """The main figures as text, one line per preset; the interval of ``held %`` in brackets."""
    found = {(row.preset, row.name): row for row in rows}
    presets = dict.fromkeys(row.preset for row in rows if row.name == "dynamic.failed_percent")
    width = max(len(preset) for preset in presets)
    lines = [f"{'':{width}s} " + "".join(f"{head:>14s}" for head, _ in _COLUMNS) + f"{'runs':>6s}"]
    for preset in presets:
        cells = []
        for _, name in _COLUMNS:
            row = found.get((preset, name))
            text = "-" if row is None else f"{row.value:.3g}"
            if row is not None and name == "dynamic.held_percent":
                text += f" [{row.low:.0f}, {row.high:.0f}]"
            cells.append(f"{text:>14s}")
        runs = found[preset, "dynamic.failed_percent"].n
        lines.append(f"{preset:{width}s} {''.join(cells)}{runs:6d}")
    return "\n".join(lines)
