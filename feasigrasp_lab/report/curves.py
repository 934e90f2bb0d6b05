"""Success rate over object speed: table and figure with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feasigrasp.outputs import save_figure
from feasigrasp.runs.metrics.table import FIGURES
from feasigrasp_lab.protocols.speed import CAMERA_MOTIONS, MOTIONS
from feasigrasp_lab.report.table_2 import Rows, figure_text
from feasigrasp_lab.results.markdown import markdown_table

FIGURE = "speed_curve.png"
#: What the curves are drawn over, by the curves.
_AXES = {
    "speed on the path [m/s]": tuple(MOTIONS | CAMERA_MOTIONS),
    "speed of the rotation [rad/s]": ("spin",),
}
_COLORS = {"circle": "#238b45", "line": "#2171b5", "bezier": "#d94801", "spin": "#6a51a3"}
#: Those with the camera alone are dashed, in the colours of the others.
_COLORS |= {camera: _COLORS[given] for camera, given in zip(CAMERA_MOTIONS, MOTIONS, strict=True)}
_COLUMNS = ("held_percent", "closing_speed_m_s", "held_after_s")


def curve_points(found: Rows, curve: str) -> list[tuple[float, str]]:
    """Speeds and presets of the points of a curve, slowest first."""
    presets = {preset for preset, name in found if name == "held_percent"}
    points = [p.partition("/") for p in presets if p.startswith(f"{curve}/")]
    return sorted((float(speed), f"{curve}/{speed}") for _, _, speed in points)


def curve_report(found: Rows, folder: Path, conditions: str) -> list[str]:
    """The parts of the report on the curves; draws `FIGURE`. None if there are no points."""
    curves = [curve for of in _AXES.values() for curve in of if curve_points(found, curve)]
    if not curves:
        return []
    draw_curves(found, curves, folder / FIGURE)
    causes = sorted({n for p, n in found if n.startswith("cause.") and p.split("/")[0] in curves})
    heads = ["", *(FIGURES[name].head for name in _COLUMNS), "failures [%]", "runs"]
    lines = []
    for curve in curves:
        for _, preset in curve_points(found, curve):
            cells = [
                figure_text(found[preset, name], FIGURES[name].decimals)
                if (preset, name) in found
                else "-"
                for name in _COLUMNS
            ]
            lost = [(found[preset, n].value, n) for n in causes if (preset, n) in found]
            words = [
                f"{n.removeprefix('cause.').removesuffix('_percent').replace('_', ' ')} {value:.0f}"
                for value, n in sorted(lost, reverse=True)
                if value > 0.0
            ]
            runs = str(found[preset, "held_percent"].n)
            lines.append([preset, *cells, ", ".join(words) or "-", runs])
    return [
        "### Success over speed",
        f"![Held over speed, with 95 % intervals]({FIGURE})",
        markdown_table(heads, lines),
        conditions,
    ]


def draw_curves(found: Rows, curves: Sequence[str], filename: Path) -> None:
    """Draws the share of runs that held over the speed; the bands are 95 % intervals."""
    panels = {label: [c for c in of if c in curves] for label, of in _AXES.items()}
    panels = {label: of for label, of in panels.items() if of}
    figure = Figure(figsize=(5.5 * len(panels), 3.8), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False, sharey=True)[0]
    for axis, (label, of) in zip(axes, panels.items(), strict=True):
        for curve in of:
            _draw_curve(axis, found, curve)
        axis.set_xlabel(label)
        axis.set_xlim(left=0.0)
        axis.set_ylim(0.0, 103.0)
        axis.grid(alpha=0.3)
        axis.spines[["top", "right"]].set_visible(False)
        axis.legend(frameon=False, loc="lower left")
    axes[0].set_ylabel("held [%]")
    save_figure(figure, filename, dpi=110)


def _draw_curve(axis: Axes, found: Rows, curve: str) -> None:
    points = curve_points(found, curve)
    rows = [found[preset, "held_percent"] for _, preset in points]
    speeds, held = [speed for speed, _ in points], [row.value for row in rows]
    low = [row.value if row.low is None else row.low for row in rows]
    high = [row.value if row.high is None else row.high for row in rows]
    color = _COLORS[curve]
    axis.fill_between(speeds, low, high, color=color, alpha=0.15, linewidth=0.0)
    style = "o--" if curve in CAMERA_MOTIONS else "o-"
    axis.plot(speeds, held, style, color=color, label=curve)
