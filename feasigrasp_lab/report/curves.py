"""Success rate over object speed: figure with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feasigrasp.outputs import save_figure
from feasigrasp_lab.protocols.speed import CAMERA_MOTIONS, MOTIONS
from feasigrasp_lab.results.rows import Row

FIGURE = "speed_curve.png"
#: What the curves are drawn over, by the curves.
_AXES = {
    "speed on the path [m/s]": tuple(MOTIONS | CAMERA_MOTIONS),
    "speed of the rotation [rad/s]": ("spin",),
}
_COLORS = {"circle": "#238b45", "line": "#2171b5", "bezier": "#d94801", "spin": "#6a51a3"}
#: Those with the camera alone are dashed, in the colors of the others.
_COLORS |= {camera: _COLORS[given] for camera, given in zip(CAMERA_MOTIONS, MOTIONS, strict=True)}
#: Rows of a summary by preset and by name without ``dynamic.``.
Rows = dict[tuple[str, str], Row]


def curve_points(found: Rows, curve: str) -> list[tuple[float, str]]:
    """Speeds and presets of the points of a curve, slowest first."""
    presets = {preset for preset, name in found if name == "held_percent"}
    points = [p.partition("/") for p in presets if p.startswith(f"{curve}/")]
    return sorted((float(speed), f"{curve}/{speed}") for _, _, speed in points)


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
