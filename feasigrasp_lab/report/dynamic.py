"""The dynamic evaluation as Markdown and as a figure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from feasigrasp.runs.metrics.table import FIGURES
from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.protocols.ablations import ABLATIONS, FULL, ablation_of
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
_LIMITS = (
    "joint_limit_violation_percent",
    "velocity_limit_violation_percent",
    "acceleration_limit_violation_percent",
    "torque_limit_violation_percent",
)
_NEAREST = ("obstacle_distance_min_mm", "obstacle_distance_min_mm.least")
#: Rows beside the paper's columns.
_MORE = (
    *_LIMITS[1:],
    "grasp_position_error_mm_median",
    "grasp_angle_error_deg_median",
    "settling_time_s",
    "grasp_switches",
    "self_distance_min_mm",
    *_NEAREST,
    "planning_ms.worst",
)
_HELD = (
    "held_percent",
    "pushed_percent",
    "pushed_mm_max",
    "contact_before_closing_percent",
    "self_collision_percent",
    *_LIMITS,
    *_NEAREST,
    "settling_time_s",
    "planning_ms.worst",
    "real_time_factor",
)
_ABLATED = (
    "held_percent",
    "held_change_percent",
    "held_after_s",
    "held_after_change_s",
    "pushed_percent",
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
            table = _metric_table(found, presets, causes)
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
    parts += [f"![The table as bars]({FIGURE})", "### Not in the paper"]
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


def _metric_table(found: Rows, presets: Iterable[str], names: Iterable[str]) -> str:
    presets = list(presets)
    names = [n for n in names if any((preset, n) in found for preset in presets)]
    lines = []
    for preset in presets:
        runs = max(row.n for (other, _), row in found.items() if other == preset)
        cells = [_cell(found, preset, name) for name in names]
        lines.append([preset, *cells, str(runs)])
    return markdown_table(["", *map(_head, names), "runs"], lines)


def _head(name: str) -> str:
    figure = FIGURES.get(name)
    return (
        f"{name.removeprefix(_CAUSE).removesuffix('_percent')} [%]"
        if figure is None
        else figure.head
    )


def _cell(found: Rows, preset: str, name: str) -> str:
    """A value with its interval; a dash without one."""
    row, figure = found.get((preset, name)), FIGURES.get(name)
    return "-" if row is None else figure_text(row, 1 if figure is None else figure.decimals)


def is_ablation(preset: str) -> bool:
    """Whether a preset is of runs of the study of ablations."""
    return bool(ablation_of(preset.split("/")[0]))


def ablation_report(found: Rows, conditions: str) -> str:
    """One line for the full system and for every ablation, by controller; nothing without any."""
    lines = []
    for suffix in ABLATIONS:
        name = "everything" if suffix == FULL else suffix.removeprefix("-").replace("-", " ")
        for controller in ("task", "joint"):
            preset = f"all{suffix}/{controller}/safe"
            if (preset, "held_percent") not in found:
                continue
            cells = [_cell(found, preset, column) for column in _ABLATED]
            runs = found[preset, "held_percent"].n
            lines.append([name, controller, *cells, str(runs)])
    if not lines:
        return ""
    heads = ["", "controller", *map(_head, _ABLATED), "runs"]
    text = (
        "Changes are those of the same object, scenario and seed against everything; of times, "
        "where both held. Intervals are of objects drawn anew."
    )
    return "\n\n".join(["### Ablations", markdown_table(heads, lines), text, conditions])
