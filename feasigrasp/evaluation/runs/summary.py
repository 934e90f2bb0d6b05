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
_NOT_AVERAGED = ("grasp_held", "object_end_x_m", "object_end_y_m", "object_end_z_m")


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Figures per scenario and controller, per controller, and over all runs.

    Presets are ``<scenario>/<controller>/<mode>``, with ``all`` where runs are put together, and
    ``<scenario>/<controller>/<mode>/<object>`` for single objects if there are several.
    Shares of runs have Wilson intervals, means over runs Student's; a figure that no run of a
    group has is left out.

    Args:
        records: Records of runs.
    """
    groups: dict[str, list[Record]] = {}
    for scenario, controller in (
        ("{scenario}", "{controller}"),
        ("all", "{controller}"),
        ("all", "all"),
    ):
        for record in records:
            preset = f"{scenario}/{controller}/{{mode}}".format_map(record)
            groups.setdefault(preset, []).append(record)
    rows = [row for preset, group in groups.items() for row in _group_rows(preset, group)]
    return rows + _object_rows(records)


def _object_rows(records: Sequence[Record]) -> list[Row]:
    groups: dict[str, list[Record]] = {}
    for record in records:
        name = Path(record["object"]).stem
        preset = "{scenario}/{controller}/{mode}".format_map(record)
        groups.setdefault(f"{preset}/{name}", []).append(record)
    if len({preset.rsplit("/")[-1] for preset in groups}) < 2:
        return []
    return [
        row
        for preset, group in groups.items()
        for name in _PER_OBJECT
        for row in _mean_row(name, preset, [r["metrics"][name] for r in group], METRICS[name])
    ]


def _group_rows(preset: str, records: Sequence[Record]) -> list[Row]:
    rows = []
    held = [r["metrics"]["grasp_held"] for r in records if r["metrics"]["grasp_held"] is not None]
    if held:
        estimate = proportion(sum(held), len(held))
        rows.append(Row.of("dynamic.held_percent", preset, estimate, "%", 100.0))
    failed = proportion(sum(r["error"] is not None for r in records), len(records))
    rows.append(Row.of("dynamic.failed_percent", preset, failed, "%", 100.0))
    for name, metric in METRICS.items():
        if name not in _NOT_AVERAGED:
            rows += _mean_row(name, preset, [r["metrics"][name] for r in records], metric)
    speeds = [r["timings"]["real_time_factor"] for r in records]
    rows += _mean_row("real_time_factor", preset, speeds, Metric("1", 0.0))
    return rows


def _mean_row(name: str, preset: str, values: Sequence[float | None], metric: Metric) -> list[Row]:
    present = [value for value in values if value is not None]
    if not present:
        return []
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
