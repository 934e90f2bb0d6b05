"""Aggregates of many runs: the rows of ``evaluate dynamic``."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.models.choices import SAFE
from feasigrasp.runs.metrics.table import METRICS, Figure, Over
from feasigrasp_lab.protocols.ablations import ablation_rows, controller_rows
from feasigrasp_lab.protocols.changes import curve_point
from feasigrasp_lab.protocols.tuned import rows_apart
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.statistics import grouped, mean_of_objects
from feasigrasp_lab.runs.studies import suffix_of

#: Rows of summaries that are of no metric.
_OTHERS = (
    Figure("failed_percent", Over.SHARE, "runs with an error"),
    Figure("real_time_factor", Over.MEAN, "simulated by wall time", "1", digits=2),
    Figure("held_change_percent", Over.MEAN, "change of grasp success"),
    Figure("held_after_change_s", Over.MEAN, "change of time to release", "s"),
)


def _figures() -> dict[str, Figure]:
    figures = list(_OTHERS)
    for name, metric in METRICS.items():
        if metric.averaged:
            figures.append(Figure(name, Over.MEAN, metric.term, metric.unit, digits=metric.digits))
        figures += metric.rows
    return {figure.name: figure for figure in figures}


#: Every row of the summary of many runs, by name.
FIGURES: dict[str, Figure] = _figures()
#: Rows that every table of runs shows: what the arm did to the object, and its true acceleration.
HANDLING = (
    "pushed_percent",
    "pushed_mm_max",
    "contact_before_closing_percent",
    "contact_impulse_n_s",
    "displaced_mm",
    "turned_deg",
    "true_acceleration_peak_percent",
    "true_acceleration_violation_percent",
)
#: Metrics that say that a limit was broken: their share of samples or ticks [%].
LIMITS = (
    "joint_limit_violation_percent",
    "velocity_limit_violation_percent",
    "acceleration_limit_violation_percent",
    "torque_limit_violation_percent",
    "self_collision_percent",
)
#: Columns of the printed table: head, row name.
_COLUMNS = (
    ("held %", "held_percent"),
    ("pushed %", "pushed_percent"),
    ("push mm", "pushed_mm_max"),
    ("contact %", "contact_before_closing_percent"),
    ("impulse N s", "contact_impulse_n_s"),
    ("displaced mm", "displaced_mm"),
    ("turned deg", "turned_deg"),
    ("true a %", "true_acceleration_violation_percent"),
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
#: Means that every object has a row of as well: those of the paper's table and the errors to the
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
#: What is taken of the runs, without an interval.
_PLAIN: dict[Over, Callable[[Sequence[float]], Any]] = {
    Over.MAX: max,
    Over.MIN: min,
    Over.MEDIAN: np.median,
}


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """Figures per scenario and controller, per controller, and over all runs (`rows_apart`).

    Presets are ``<scenario>/<controller>/<mode>``, with ``all`` (and the suffix of a study) where
    runs are put together, ``<motion>/<m/s>`` for the points of the speed curve, and
    ``<scenario>/<controller>/<mode>/<object>`` for single objects if there are several. In means
    and shares every object counts once; intervals of means come from drawing the objects anew. A
    figure that no run of a group has is left out. Ablations are compared with the runs of the whole
    (`ablation_rows`), controllers with ``task`` (`controller_rows`).
    """
    return rows_apart(records, _summary_rows)


def _summary_rows(records: Sequence[Record]) -> list[Row]:
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
    return rows + ablation_rows(records) + controller_rows(records)


def handling_rows(preset: str, records: Sequence[Record]) -> list[Row]:
    """The rows `HANDLING` of a group of runs, of the command ``evaluate dynamic``."""
    names = [f"dynamic.{name}" for name in HANDLING]
    return [row for row in _group_rows(preset, records, ()) if row.name in names]


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

    Of several modes only ``safe`` is in them.
    """
    modes = {record["mode"] for record in records}
    of_one = [record for record in records if len(modes) == 1 or record["mode"] == SAFE]
    points = grouped(of_one, lambda record: curve_point(record["scenario"]))
    return {point: group for point, group in points.items() if point is not None}


def _group_rows(preset: str, records: Sequence[Record], causes: Sequence[str]) -> list[Row]:
    rows = _share_rows(preset, records) + _cause_rows(preset, records, causes)
    for name, metric in METRICS.items():
        if metric.averaged:
            rows += _mean_row(name, preset, records)
        for figure in metric.rows:
            values = [value for value, _ in _present(name, records)]
            if values and figure.over in _PLAIN:
                value = _PLAIN[figure.over](values)
                row = Row.plain(f"dynamic.{figure.name}", preset, value, figure.unit, len(values))
                rows.append(row)
    return rows + _mean_row("real_time_factor", preset, records)


def _share_rows(preset: str, records: Sequence[Record]) -> list[Row]:
    """Shares of runs: those of the metrics, and of runs with an error."""
    rows = []
    for name, metric in METRICS.items():
        for figure in metric.rows:
            present = _present(name, records)
            if present and figure.over is Over.SHARE:
                values, objects = zip(*present, strict=True)
                true = [value > figure.above for value in values]
                rows.append(Row.percent(f"dynamic.{figure.name}", preset, true, objects))
    broken = [run["error"] is not None for run in records]
    names = [run["object"] for run in records]
    return [*rows, Row.percent("dynamic.failed_percent", preset, broken, names)]


def _cause_rows(preset: str, records: Sequence[Record], causes: Sequence[str]) -> list[Row]:
    """Of the runs that close the hand, how many percent did not hold for each reason."""
    closing = [run for run in records if run["metrics"]["grasp_held"] is not None]
    objects = [run["object"] for run in closing]
    return [
        Row.percent(
            f"dynamic.cause.{cause}_percent",
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
    metric = METRICS.get(name)
    bounds = (metric.lower, metric.upper) if metric else (0.0, math.inf)
    estimate = mean_of_objects(values, objects, *bounds)
    return [Row.of(f"dynamic.{name}", preset, estimate, FIGURES[name].unit)]


def _present(name: str, records: Sequence[Record]) -> list[tuple[float, str]]:
    """A metric or timing of the records that have it, with their objects."""
    found = [((r["metrics"] | r["timings"]).get(name), r["object"]) for r in records]
    return [(float(value), each) for value, each in found if value is not None]


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
