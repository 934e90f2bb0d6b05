"""The dynamic evaluation as Markdown and as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.report.ablation import ablation_report, is_ablation
from feasigrasp_lab.report.curves import curve_report
from feasigrasp_lab.report.table_2 import (
    SPEEDS,
    Rows,
    draw_table_2,
    figure_text,
    speeds_of,
    table_2,
)
from feasigrasp_lab.results.markdown import markdown_table

FIGURE = "dynamic_table.png"
#: Columns of tables: row name, heading, digits.
Columns = Sequence[tuple[str, str, int]]

_LIMITS: Columns = (
    ("joint_limit_violation_percent", "joint limits violated [%]", 2),
    ("velocity_limit_violation_percent", "velocity limits violated [%]", 2),
    ("acceleration_limit_violation_percent", "acceleration limits violated [%]", 2),
    ("torque_limit_violation_percent", "torque limits violated [%]", 2),
)
_NEAREST: Columns = (
    ("obstacle_distance_min_mm", "to table and obstacles, mean of runs [mm]", 0),
    ("obstacle_distance_min_mm.least", "least [mm]", 0),
)
#: What the simulation tells beside the paper's columns.
_MORE: Columns = (
    *_LIMITS[1:],
    ("grasp_position_error_mm_median", "to the nearest grasp [mm]", 1),
    ("grasp_angle_error_deg_median", "[deg]", 1),
    ("settling_time_s", "settled after [s]", 2),
    ("grasp_switches", "switches of grasp", 1),
    ("self_distance_min_mm", "least distance to itself [mm]", 0),
    *_NEAREST,
    ("planning_ms.worst", "slowest planning [ms]", 0),
)
_HELD: Columns = (
    ("held_percent", "held [%]", 1),
    ("pushed_percent", "pushed [%]", 1),
    ("pushed_mm_max", "pushed at most [mm]", 0),
    ("contact_before_closing_percent", "touched before closing [%]", 1),
    ("self_collision_percent", "self-collision [%]", 2),
    *_LIMITS,
    *_NEAREST,
    ("settling_time_s", "settled after [s]", 2),
    ("planning_ms.worst", "slowest planning [ms]", 0),
    ("real_time_factor", "x real time", 2),
)
_CAUSE = "cause."


def dynamic_report(rows: Sequence[Row], folder: Path, conditions: str = "") -> str:
    """The report's text; draws figures in ``folder`` of the paper's scenarios and of speed curves.

    Args:
        rows: Rows of ``summary.json``.
        folder: Where the figure goes.
        conditions: What stands under every table.
    """
    found: Rows = {(row.preset, row.name.removeprefix("dynamic.")): row for row in rows}
    parts = _paper_parts(found, folder, conditions) if speeds_of(found) else []
    parts += curve_report(found, folder, conditions)
    parts += [ablation_report(found, conditions)]
    found = {key: row for key, row in found.items() if not is_ablation(key[0])}
    presets = [p for p in _presets(found) if (p, "held_percent") in found]
    if presets:
        parts += ["### Grasping moving objects", _metric_table(found, presets, _HELD), conditions]
        causes = sorted({n for _, n in found if n.startswith(_CAUSE)})
        if causes:
            heads = [n.removeprefix(_CAUSE).replace("_percent", " [%]") for n in causes]
            columns = [(n, head, 1) for n, head in zip(causes, heads, strict=True)]
            table = _metric_table(found, presets, columns)
            parts += ["### Why runs did not hold", table, conditions]
        parts += _object_parts(found, conditions)
    return "\n\n".join(filter(None, parts))


def _paper_parts(found: Rows, folder: Path, conditions: str) -> list[str]:
    draw_table_2(found, folder / FIGURE)
    parts = []
    for speed in speeds_of(found):
        parts += [
            f"### The paper's Table II, beside ours at {SPEEDS[speed]}",
            table_2(found, speed),
            "Printed: mean and standard deviation over five runs, at a speed that the paper does "
            "not give. Ours: mean over all runs of a row and its 95 % interval. The best figure of "
            "a column is bold.",
            conditions,
        ]
    presets = [preset for preset in _presets(found) if preset.startswith("Paper")]
    parts += [f"![The table as bars]({FIGURE})", "### What the paper does not tell"]
    return [*parts, _metric_table(found, presets, _MORE), conditions]


def _object_parts(found: Rows, conditions: str) -> list[str]:
    """How many runs held each object: a line an object, a column a preset."""
    single = [(preset, name) for preset, name in found if preset.count("/") == 3]
    cells = {preset: found[preset, name] for preset, name in single if name == "held_percent"}
    presets = list(dict.fromkeys(preset.rpartition("/")[0] for preset in cells))
    objects = list(dict.fromkeys(preset.rpartition("/")[2] for preset in cells))
    if not objects:
        return []
    lines = []
    for each in objects:
        held = [cells.get(f"{preset}/{each}") for preset in presets]
        lines.append([each, *("-" if row is None else f"{row.value:.0f}" for row in held)])
    return ["### Held, object by object [%]", markdown_table(["", *presets], lines), conditions]


def _presets(found: Rows) -> list[str]:
    """Presets that are not of single objects."""
    return [p for p in dict.fromkeys(preset for preset, _ in found) if p.count("/") == 2]


def _metric_table(found: Rows, presets: Iterable[str], columns: Columns) -> str:
    presets = list(presets)
    columns = [c for c in columns if any((preset, c[0]) in found for preset in presets)]
    lines = []
    for preset in presets:
        cells = [
            figure_text(found[preset, name], digits) if (preset, name) in found else "-"
            for name, _, digits in columns
        ]
        runs = max(row.n for (other, _), row in found.items() if other == preset)
        lines.append([preset, *cells, str(runs)])
    return markdown_table(["", *(head for _, head, _ in columns), "runs"], lines)
