"""The paper's Table II beside ours, as Markdown and as a figure."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.report.paper_tables import TABLE_2, TABLE_2_COLUMNS
from feasigrasp_lab.results.markdown import markdown_table

#: Rows of a summary by preset and by name without ``dynamic.``.
Rows = dict[tuple[str, str], Row]

#: Ending of our scenarios' names -> phase rate. The paper does not give its own.
SPEEDS = {"": "0.3 rad/s", "Fast": "1.2 rad/s"}
#: The paper's columns, and one that it does not have.
COLUMNS = {**TABLE_2_COLUMNS, "tracked_percent": ("time at a grasp [%]", 1, True)}
#: Colours: the paper's printed figures in greys, ours in colour; what enforces more is darker.
_COLORS = {
    "printed: joint space": "#9a9a9a",
    "printed: task space": "#6e6e6e",
    "printed: grasp diffusion": "#c8c8c8",
    "joint, paper": "#c6dbef",
    "joint, corrected": "#6baed6",
    "joint, safe": "#2171b5",
    "task, paper": "#c7e9c0",
    "task, corrected": "#74c476",
    "task, safe": "#238b45",
}
_PRINTED = "printed: "


def preset_of(label: str, trajectory: str, speed: str) -> str:
    """The preset of one of our labels, e.g. ``joint, safe``, on a trajectory of the paper."""
    controller, mode = label.split(", ")
    return f"Paper{trajectory}{speed}/{controller}/{mode}"


def speeds_of(found: Rows) -> list[str]:
    """Which of `SPEEDS` there are rows of."""
    scenarios = {preset.split("/")[0] for preset, _ in found}
    return [speed for speed in SPEEDS if {f"Paper{name}{speed}" for name in TABLE_2} & scenarios]


def table_2(found: Rows, speed: str) -> str:
    """The paper's printed figures and ours at a speed; the best of a column is bold."""
    heads, lines = ["trajectory", "method", *(head for head, _, _ in COLUMNS.values())], []
    for trajectory in TABLE_2:
        entries = {label: _cells(found, label, trajectory, speed) for label in _COLORS}
        entries = {label: cells for label, cells in entries.items() if any(cells)}
        best = [
            _best([cells[column] for cells in entries.values()], digits, more)
            for column, (_, digits, more) in enumerate(COLUMNS.values())
        ]
        for label, cells in entries.items():
            texts = ["-" if cell is None else cell[1] for cell in cells]
            marked = [f"**{t}**" if t in of else t for t, of in zip(texts, best, strict=True)]
            lines.append([trajectory, label, *marked])
    return markdown_table(heads, lines)


#: A figure and its text; None where there is none.
Cell = tuple[float, str] | None


def _best(cells: Sequence[Cell], digits: int, more: bool) -> set[str]:
    """Texts of the best figures of a column, at its number of digits."""
    there = [(round(cell[0], digits), cell[1]) for cell in cells if cell is not None]
    values = [value for value, _ in there]
    best = (max if more else min)(values, default=None)
    return {text for value, text in there if value == best}


def _cells(found: Rows, label: str, trajectory: str, speed: str) -> list[Cell]:
    """Figure and text of every column, None where there is none."""
    cells: list[Cell] = []
    if label.startswith(_PRINTED):
        printed = TABLE_2[trajectory][label.removeprefix(_PRINTED)]
        for (mean, deviation), (_, digits, _) in zip(printed, COLUMNS.values(), strict=False):
            cells.append((mean, f"{mean:.{digits}f} ({deviation:.{digits}f})"))
        return cells + [None] * (len(COLUMNS) - len(cells))
    preset = preset_of(label, trajectory, speed)
    for name, (_, digits, _) in COLUMNS.items():
        row = found.get((preset, name))
        cells.append(None if row is None else (row.value, figure_text(row, digits)))
    return cells


def figure_text(row: Row, digits: int) -> str:
    """A figure with its interval."""
    text = f"{row.value:.{digits}f}"
    if row.low is None or row.high is None:
        return text
    return f"{text} [{row.low:.{digits}f}, {row.high:.{digits}f}]"


def draw_table_2(found: Rows, filename: Path) -> None:
    """Draws the columns as bars, the paper's figures and ours side by side, a speed a column."""
    speeds = speeds_of(found)
    figure = Figure(figsize=(6.5 * len(speeds), 2.4 * len(COLUMNS)), layout="constrained")
    axes = figure.subplots(len(COLUMNS), len(speeds), squeeze=False, sharey="row")
    for row, name in zip(axes, COLUMNS, strict=True):
        for axis, speed in zip(row, speeds, strict=True):
            _draw_column(axis, found, name, speed)
        row[0].autoscale(axis="y")  # for the bars of all speeds
        row[0].set_ylim(bottom=0.0)
    handles = [Patch(color=color, label=label) for label, color in _COLORS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=3, frameon=False)
    save_figure(figure, filename, dpi=100)


def _draw_column(axis: Axes, found: Rows, name: str, speed: str) -> None:
    width, column = 0.85 / len(_COLORS), list(COLUMNS).index(name)
    for index, (label, color) in enumerate(_COLORS.items()):
        at, values, errors = [], [], []
        for x, trajectory in enumerate(TABLE_2):
            bar = _bar(found, label, trajectory, name, column, speed)
            if bar is not None:
                at.append(x + (index - 0.5 * (len(_COLORS) - 1)) * width)
                values.append(bar[0])
                errors.append(bar[1:])
        spread = np.transpose(errors) if errors else None
        axis.bar(at, values, 0.92 * width, color=color)
        axis.errorbar(at, values, spread, fmt="none", ecolor="#222222", elinewidth=0.8, capsize=2)
        for bar_at, value in zip(at, values, strict=True):
            if value == 0.0:  # a bar of nothing would look like a missing one
                axis.text(bar_at, 0.0, "0", ha="center", va="bottom", fontsize=6)
    head, _, more = COLUMNS[name]
    better = "more" if more else "less"
    axis.set_title(f"{head} at {SPEEDS[speed]} ({better} is better)", fontsize=10)
    axis.set_xticks(range(len(TABLE_2)), list(TABLE_2))
    axis.set_xlim(-0.5, len(TABLE_2) - 0.5)
    axis.grid(axis="y", alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)


def _bar(
    found: Rows, label: str, trajectory: str, name: str, column: int, speed: str
) -> tuple[float, float, float] | None:
    """Height of a bar, and how far its error reaches down and up."""
    if label.startswith(_PRINTED):
        printed = TABLE_2[trajectory][label.removeprefix(_PRINTED)]
        if column >= len(printed):
            return None
        mean, deviation = printed[column]
        return mean, deviation, deviation
    row = found.get((preset_of(label, trajectory, speed), name))
    if row is None:
        return None
    if row.low is None or row.high is None:
        return row.value, 0.0, 0.0
    return row.value, row.value - row.low, row.high - row.value
