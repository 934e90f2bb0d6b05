"""The dynamic evaluation as Markdown and as a figure, the paper's Table II beside ours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from feasigrasp.evaluation.report.paper_tables import TABLE_2, TABLE_2_COLUMNS
from feasigrasp.outputs import save_figure
from feasigrasp.results.markdown import markdown_table
from feasigrasp.results.rows import Row

Rows = dict[tuple[str, str], Row]

FIGURE = "dynamic_table.png"
#: What the simulation tells beside the paper's columns: row name, heading, digits.
_MORE = (
    ("velocity_limit_violation_percent", "velocity limits violated [%]", 2),
    ("acceleration_limit_violation_percent", "acceleration limits violated [%]", 2),
    ("grasp_position_error_mm_median", "to the nearest grasp [mm]", 1),
    ("grasp_angle_error_deg_median", "[deg]", 1),
    ("tracked_percent", "tracked [%]", 1),
    ("settling_time_s", "settled after [s]", 2),
    ("grasp_switches", "switches of grasp", 1),
    ("self_distance_min_mm", "least distance to itself [mm]", 0),
    ("obstacle_distance_min_mm", "to table and obstacles [mm]", 0),
)
_HELD = (
    ("held_percent", "held [%]", 1),
    ("self_collision_percent", "self-collision [%]", 2),
    ("joint_limit_violation_percent", "joint limits violated [%]", 2),
    ("velocity_limit_violation_percent", "velocity limits violated [%]", 2),
    ("acceleration_limit_violation_percent", "acceleration limits violated [%]", 2),
    ("settling_time_s", "settled after [s]", 2),
    ("slip_mm", "slip [mm]", 2),
    ("obstacle_distance_min_mm", "to table and obstacles [mm]", 0),
    ("real_time_factor", "x real time", 2),
)
#: Colours: the paper's methods in greys, ours in colour; safe darker than paper mode.
_COLORS = {
    "paper: joint space": "#9a9a9a",
    "paper: task space": "#6e6e6e",
    "paper: grasp diffusion": "#c8c8c8",
    "joint, paper mode": "#9ecae1",
    "task, paper mode": "#a1d99b",
    "joint, safe mode": "#2171b5",
    "task, safe mode": "#238b45",
}


def dynamic_report(rows: Sequence[Row], folder: Path) -> str:
    """The report's text; draws `FIGURE` in ``folder`` if there are runs of the paper's scenarios.

    Args:
        rows: Rows of ``summary.json``.
        folder: Where the figure goes.
    """
    found: Rows = {(row.preset, row.name.removeprefix("dynamic.")): row for row in rows}
    parts = []
    if any(preset.startswith("Paper") for preset, _ in found):
        parts += _paper_parts(found, folder)
    presets = _presets(found, "Reach")
    if presets:
        parts += ["### Grasping moving objects", _metric_table(found, presets, _HELD)]
    return "\n\n".join(parts)


def _paper_parts(found: Rows, folder: Path) -> list[str]:
    draw_table_2(found, folder / FIGURE)
    presets = _presets(found, "Paper")
    objects = sorted({preset.split("/")[3] for preset, _ in found if preset.count("/") == 3})
    parts = [
        "### The paper's Table II, beside ours",
        _table_2(found),
        "Ours: mean over all runs of a row and its 95 % interval. Paper: mean and standard "
        "deviation over five runs. The best figure of a column is bold.",
        f"![The table as bars]({FIGURE})",
        "### What the paper does not tell",
        _metric_table(found, presets, _MORE),
    ]
    single = [f"{preset}/{name}" for preset in presets for name in objects]
    single = [preset for preset in single if (preset, "manipulability_mean") in found]
    if single:
        columns = [(name, head, digits) for name, (head, digits, _) in TABLE_2_COLUMNS.items()]
        parts += ["### Object by object", _metric_table(found, single, columns)]
    return parts


def _presets(found: Rows, prefix: str) -> list[str]:
    """Presets of single scenarios with all their objects."""
    presets = dict.fromkeys(preset for preset, _ in found)
    return [p for p in presets if p.startswith(prefix) and p.count("/") == 2]


def _ours(found: Rows, trajectory: str) -> list[tuple[str, str]]:
    """Label and preset of our runs on a trajectory of the paper."""
    choices = [
        (f"{controller}, {mode} mode", f"Paper{trajectory}/{controller}/{mode}")
        for mode in ("paper", "safe")
        for controller in ("joint", "task")
    ]
    return [(label, p) for label, p in choices if (p, "manipulability_mean") in found]


def _table_2(found: Rows) -> str:
    lines, digits_of = [], [digits for _, digits, _ in TABLE_2_COLUMNS.values()]
    for trajectory, methods in TABLE_2.items():
        entries: list[tuple[str, list[float], list[str]]] = []
        for method, figures in methods.items():
            texts = [
                f"{mean:.{d}f} ({deviation:.{d}f})"
                for (mean, deviation), d in zip(figures, digits_of, strict=True)
            ]
            entries.append((f"paper: {method}", [mean for mean, _ in figures], texts))
        for label, preset in _ours(found, trajectory):
            ours = [found[preset, name] for name in TABLE_2_COLUMNS]
            texts = [_figure(row, d) for row, d in zip(ours, digits_of, strict=True)]
            entries.append((f"**{label}**", [row.value for row in ours], texts))
        for column, (_, digits, more) in enumerate(TABLE_2_COLUMNS.values()):
            values = [round(entry[1][column], digits) for entry in entries]
            best = max(values) if more else min(values)
            for value, entry in zip(values, entries, strict=True):
                if value == best:
                    entry[2][column] = f"**{entry[2][column]}**"
        lines += [[trajectory, label, *texts] for label, _, texts in entries]
    heads = ["trajectory", "method", *(head for head, _, _ in TABLE_2_COLUMNS.values())]
    return markdown_table(heads, lines)


def _metric_table(
    found: Rows, presets: Iterable[str], columns: Iterable[tuple[str, str, int]]
) -> str:
    columns = [c for c in columns if any((preset, c[0]) in found for preset in presets)]
    lines = []
    for preset in presets:
        cells = [
            _figure(found[preset, name], digits) if (preset, name) in found else "-"
            for name, _, digits in columns
        ]
        runs = max(row.n for (other, _), row in found.items() if other == preset)
        lines.append([preset, *cells, str(runs)])
    return markdown_table(["", *(head for _, head, _ in columns), "runs"], lines)


def _figure(row: Row, digits: int) -> str:
    text = f"{row.value:.{digits}f}"
    if row.low is None or row.high is None:
        return text
    return f"{text} [{row.low:.{digits}f}, {row.high:.{digits}f}]"


def draw_table_2(found: Rows, filename: Path) -> None:
    """Draws the columns of Table II as bars, the paper's methods and ours side by side."""
    figure = Figure(figsize=(11.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    for column, (axis, name) in enumerate(zip(axes.flat, TABLE_2_COLUMNS, strict=True)):
        _draw_column(axis, found, name, column)
    handles = [Patch(color=color, label=label) for label, color in _COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    save_figure(figure, filename, dpi=110)


def _draw_column(axis: Axes, found: Rows, name: str, column: int) -> None:
    width, labels = 0.8 / len(_COLORS), list(_COLORS)
    for index, label in enumerate(labels):
        at, values, errors = [], [], []
        for x, trajectory in enumerate(TABLE_2):
            if label.startswith("paper: "):
                mean, deviation = TABLE_2[trajectory][label.removeprefix("paper: ")][column]
                bar = (mean, (deviation, deviation))
            else:
                preset = dict(_ours(found, trajectory)).get(label)
                row = found.get((preset or "", name))
                if row is None:
                    continue
                low = row.value if row.low is None else row.low
                high = row.value if row.high is None else row.high
                bar = (row.value, (row.value - low, high - row.value))
            at.append(x + (index - 0.5 * (len(labels) - 1)) * width)
            values.append(bar[0])
            errors.append(bar[1])
        spread = np.transpose(errors) if errors else None
        axis.bar(at, values, 0.92 * width, color=_COLORS[label])
        axis.errorbar(at, values, spread, fmt="none", ecolor="#222222", elinewidth=0.8, capsize=2)
        for bar_at, value in zip(at, values, strict=True):
            if value == 0.0:  # a bar of nothing would look like a missing one
                axis.text(bar_at, 0.0, "0", ha="center", va="bottom", fontsize=7)
    head, _, more = list(TABLE_2_COLUMNS.values())[column]
    axis.set_title(f"{head} ({'more' if more else 'less'} is better)", fontsize=10)
    axis.set_xticks(range(len(TABLE_2)), list(TABLE_2))
    axis.set_xlim(-0.5, len(TABLE_2) - 0.5)
    axis.set_ylim(bottom=0.0)
    axis.grid(axis="y", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
