"""Tables of a summary as Markdown: the paper's figures beside ours, curves, causes, objects."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feasigrasp.outputs import save_figure
from feasigrasp_lab.protocols.ablations import ablation_of
from feasigrasp_lab.protocols.changes import CAMERA_MOTIONS, MOTIONS
from feasigrasp_lab.protocols.fault_table import FAULTS
from feasigrasp_lab.report.paper_tables import TABLE_1, TABLE_1_ABLATION, TABLE_2, TABLE_2_COLUMNS
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.runs.summary import FIGURES, HANDLING, LIMITS

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


def draw_curves(found: Rows, curves: Sequence[str], filename: Path, source: str = "") -> None:
    """Draws the share held over the speed, with 95 % intervals; ``source`` goes into the file."""
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
    save_figure(figure, filename, dpi=110, metadata={"Source": source})


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


_CAUSES = r"cause\..*"


@dataclass(frozen=True)
class _Table:
    """A table of the dynamic evaluation.

    Attributes:
        head: Its heading.
        presets: Regular expression of the presets that are its lines.
        names: Regular expressions of the rows that are its columns.
        ablations: Whether it has the runs of ablations, and no others.
        note: What stands below it.
    """

    head: str
    presets: str
    names: tuple[str, ...]
    ablations: bool = False
    note: str = ""


_TABLES = (
    _Table(
        "The paper's Table II, beside ours",
        r"Paper\w+/\w+/\w+",
        (*TABLE_2_COLUMNS, "tracked_percent"),
        note="Printed: mean and standard deviation over five runs, at a speed that the paper does "
        "not give; ours: 0.3 rad/s, `Fast` 1.2 rad/s, mean and 95 % interval.",
    ),
    _Table(
        "Not in the paper",
        r"Paper\w+/\w+/\w+",
        (
            *HANDLING,
            *LIMITS[1:4],
            "grasp_position_error_mm_median",
            "grasp_angle_error_deg_median",
            "settling_time_s",
            "grasp_switches",
            "self_distance_min_mm",
            r"obstacle_distance_min_mm.*",
            r"planning_ms\.worst",
        ),
    ),
    _Table(
        "Success over speed",
        r"[\w-]+/[\d.]+",
        ("held_percent", "closing_speed_m_s", "held_after_s", *HANDLING, _CAUSES),
    ),
    _Table(
        "Ablations",
        r"all-[\w-]+/(task|joint)/safe",
        ("held_percent", "held_change_percent", "held_after_s", "held_after_change_s", *HANDLING),
        ablations=True,
        note="Changes are those of the same object, scenario and seed against `full`; of times, "
        "where both held. Intervals are of objects drawn anew.",
    ),
    _Table(
        "Grasping moving objects",
        r"(?!Paper)[\w-]+/\w+/\w+",
        (
            "held_percent",
            *HANDLING,
            "self_collision_percent",
            *LIMITS[:4],
            r"obstacle_distance_min_mm.*",
            "settling_time_s",
            r"planning_ms\.worst",
            "real_time_factor",
        ),
    ),
    _Table("Why runs did not hold", r"[\w-]+/\w+/\w+", (_CAUSES,)),
)


def dynamic_report(rows: Sequence[Row], folder: Path, conditions: str) -> str:
    """The report on the dynamic evaluation; draws the speed curves in ``folder``.

    Under every table stand the conditions.
    """
    found = _by_preset(rows, "dynamic.")
    parts = []
    for table in _TABLES:
        printed = _printed_table_2() if table.names[0] in TABLE_2_COLUMNS else []
        text = _metric_table(found, table, printed)
        if text:
            curves = [curve for curve in _curves(found) if table.head == "Success over speed"]
            parts += [f"### {table.head}"]
            if curves:
                draw_curves(found, curves, folder / FIGURE)
                parts += [f"![Held over speed, with 95 % intervals]({FIGURE})"]
            parts += [text, table.note, conditions]
    objects = {(p, n): row for (p, n), row in found.items() if p.count("/") == 3}
    parts += _object_table(objects, "held_percent", conditions)
    return "\n\n".join(filter(None, parts))


def _curves(found: Rows) -> list[str]:
    presets = [preset for preset, _ in found if preset.count("/") == 1]
    curves = dict.fromkeys(preset.partition("/")[0] for preset in presets)
    return [curve for curve in curves if curve_points(found, curve)]


def _metric_table(found: Rows, table: _Table, printed: Iterable[Sequence[str]]) -> str:
    """The rows of a table, behind lines that are printed elsewhere; empty without any."""
    presets = [
        preset
        for preset in dict.fromkeys(preset for preset, _ in found)
        if re.fullmatch(table.presets, preset)
        and bool(ablation_of(preset.split("/")[0])) == table.ablations
    ]
    there = dict.fromkeys(name for preset, name in found if preset in presets)
    names = [n for pattern in table.names for n in sorted(there) if re.fullmatch(pattern, n)]
    presets = [preset for preset in presets if any((preset, name) in found for name in names)]
    if not presets:
        return ""
    lines = [[*line, *["-"] * (len(names) + 2 - len(line))] for line in printed]
    for preset in presets:
        runs = max(row.n for (other, _), row in found.items() if other == preset)
        cells = [_cell(found.get((preset, name)), _digits(name)) for name in names]
        lines.append([preset, *cells, str(runs)])
    return markdown_table(["", *map(_head, names), "runs"], lines)


def _printed_table_2() -> list[list[str]]:
    digits = [digits for _, digits, _ in TABLE_2_COLUMNS.values()]
    return [
        [f"{trajectory}, printed: {method}"]
        + [f"{m:.{d}f} ({s:.{d}f})" for (m, s), d in zip(figures, digits, strict=True)]
        for trajectory, methods in TABLE_2.items()
        for method, figures in methods.items()
    ]


def static_report(rows: Sequence[Row], conditions: str) -> str:
    """The report on objects at rest, beside the paper's Table I and its ablation."""
    found = _by_preset(rows, "static.")
    mean, deviation = TABLE_1
    names = [name for name in HANDLING if any(name == n for _, n in found)]
    empty = ["-"] * (len(names) + 2)
    lines = [["printed: the paper", f"{mean:.2f} ({deviation:.2f})", *empty]]
    for stage, share in zip(("", "+filter", "+filter+reachability"), TABLE_1_ABLATION, strict=True):
        lines.append([f"printed: network{stage}", f"{share:.1f}", *empty])
    for (preset, name), row in found.items():
        if name == "held_percent":
            causes = [
                f"{_head(n)} {why.value:.1f}"
                for (p, n), why in found.items()
                if p == preset and n.startswith("cause.")
            ]
            cells = [_cell(found.get((preset, key)), _digits(key)) for key in names]
            lines.append([preset, _cell(row, 1), *cells, ", ".join(causes) or "-", str(row.n)])
    heads = ["protocol", "held [%]", *map(_head, names), "why not [%]", "trials"]
    table = markdown_table(heads, lines)
    parts = ["### Grasping objects at rest", table, conditions]
    parts += _object_table(found, "object_held_percent", conditions)
    return "\n\n".join(filter(None, parts))


#: Figures of a fault: row name behind ``faults.``, heading, digits.
_FAULTS = (
    ("held_percent", "held [%]", 0),
    ("named_percent", "held or named [%]", 0),
    ("noticed_s", "noticed after [s]", 2),
    ("limits_broken", "limits broken", 0),
    ("crashes", "crashes", 0),
)
#: What is said of the rows about an arm whose object is lost for good.
_RESTS = {
    "rest_s": "commanded to rest {:.2f} s after the stated silence or after a touch since then",
    "rest_pushed_s": "in motion, pushed by the object or not, {:.2f} s after the stated silence",
}


def faults_report(rows: Sequence[Row]) -> str:
    """The report on faults: one line for each, and what holds for all of them."""
    found = _by_preset(rows, "faults.")
    lines = []
    for name in (*FAULTS, "all"):
        if (name, "crashes") not in found:
            continue
        figures = [(found.get((name, key)), digits) for key, _, digits in _FAULTS]
        cells = ["" if row is None else f"{row.value:.{digits}f}" for row, digits in figures]
        what = FAULTS[name].what if name in FAULTS else ""
        mark = " *" if name in FAULTS and FAULTS[name].held else ""
        lines.append([f"`{name}`{mark}", what, *cells, str(found[name, "crashes"].n)])
    heads = ["fault", "what goes wrong", *(head for _, head, _ in _FAULTS)]
    parts = [
        markdown_table([*heads, "runs"], lines),
        "Limits broken and crashes count runs; `*`: the object is to be held nevertheless.",
    ]
    if leaks := found.get(("all", "truth_leaks")):
        parts.append(f"Truth leaked in {leaks.value:.0f} of {leaks.n} pairs of runs.")
    for key, when in _RESTS.items():
        if rest := found.get(("all", key)):
            parts.append(
                f"With the pose lost for good, the arm was {when.format(rest.value)} at the latest "
                f"({rest.n} runs)."
            )
    return "\n\n".join(parts)


def markdown_table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table; every line has as many cells as ``heads``."""
    rows = [list(heads), ["---"] * len(heads), *map(list, lines)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def _by_preset(rows: Sequence[Row], first: str) -> Rows:
    return {(row.preset, row.name.removeprefix(first)): row for row in rows}


def _object_table(found: Rows, name: str, conditions: str) -> list[str]:
    """How many runs held each object: a line an object, a column the rest of its preset."""
    cells = {preset.rpartition("/"): row for (preset, n), row in found.items() if n == name}
    if not cells:
        return []
    groups = list(dict.fromkeys(group for group, _, _ in cells))
    lines = [
        [each, *(_cell(cells.get((group, "/", each)), 0).partition(" ")[0] for group in groups)]
        for each in dict.fromkeys(each for _, _, each in cells)
    ]
    return ["### Held, object by object [%]", markdown_table(["", *groups], lines), conditions]


def _head(name: str) -> str:
    cause = name.removeprefix("cause.").removesuffix("_percent").replace("_", " ")
    return FIGURES[name].head if name in FIGURES else f"{cause} [%]"


def _digits(name: str) -> int:
    return FIGURES[name].decimals if name in FIGURES else 1


def _cell(row: Row | None, digits: int) -> str:
    """A value with its interval; a dash without one."""
    if row is None:
        return "-"
    text = f"{row.value:.{digits}f}"
    if row.low is None or row.high is None:
        return text
    return f"{text} [{row.low:.{digits}f}, {row.high:.{digits}f}]"
