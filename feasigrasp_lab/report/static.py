"""The static test beside the paper's Table I and its ablation, and the study of faults."""

from __future__ import annotations

from collections.abc import Sequence

from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.protocols.fault_table import FAULTS
from feasigrasp_lab.protocols.static import ABLATIONS, PROTOCOLS
from feasigrasp_lab.report.paper_tables import TABLE_1, TABLE_1_ABLATION
from feasigrasp_lab.report.table_2 import Rows, figure_text
from feasigrasp_lab.results.markdown import markdown_table


def static_report(rows: Sequence[Row], conditions: str = "") -> str:
    """The report's text.

    Args:
        rows: Rows of ``summary.json``.
        conditions: What stands under every table.
    """
    found: Rows = {(row.preset, row.name.removeprefix("static.")): row for row in rows}
    protocols = [name for name in PROTOCOLS if (name, "held_percent") in found]
    parts = ["### Grasping objects at rest", _protocols(found, protocols), conditions]
    if any(f"{name}/{part}" in {p for p, _ in found} for name in protocols for part in ABLATIONS):
        parts += ["### What each stage adds, held [%]", _ablation(found, protocols), conditions]
    objects = [(p, n) for p, n in found if n == "object_held_percent"]
    if objects:
        parts += ["### Held, object by object [%]", _objects(found, protocols), conditions]
    return "\n\n".join(filter(None, parts))


def _protocols(found: Rows, protocols: Sequence[str]) -> str:
    mean, deviation = TABLE_1
    lines = [["printed: the paper", f"{mean:.2f} ({deviation:.2f})", "-", "-", "-"]]
    for name in protocols:
        causes = {
            n.removeprefix("cause.").removesuffix("_percent").replace("_", " "): row.value
            for (preset, n), row in found.items()
            if preset == name and n.startswith("cause.")
        }
        why = ", ".join(f"{cause} {value:.1f}" for cause, value in causes.items())
        held, seconds = found[name, "held_percent"], found.get((name, "run_s"))
        time = "-" if seconds is None else f"{seconds.value:.1f}"
        lines.append([name, figure_text(held, 1), why or "-", time, str(held.n)])
    return markdown_table(["protocol", "held [%]", "why not [%]", "s/trial", "trials"], lines)


def _ablation(found: Rows, protocols: Sequence[str]) -> str:
    stages = list(dict.fromkeys(part.partition("+")[2] for part in ABLATIONS))
    samplers = list(dict.fromkeys(part.partition("+")[0] for part in ABLATIONS))
    lines = [["printed: the paper", *(f"{value:.1f}" for value in TABLE_1_ABLATION)]]
    for name in protocols:
        for sampler in samplers:
            presets = [f"{name}/{'+'.join(filter(None, (sampler, stage)))}" for stage in stages]
            cells = [found.get((preset, "held_percent")) for preset in presets]
            texts = ["-" if cell is None else figure_text(cell, 1) for cell in cells]
            lines.append([f"{name}, {sampler}", *texts])
    heads = ["", *(f"+ {stage.replace('+', ' + ')}" if stage else "sampler" for stage in stages)]
    return markdown_table(heads, lines)


def _objects(found: Rows, protocols: Sequence[str]) -> str:
    names = dict.fromkeys(p.partition("/")[2] for p, n in found if n == "object_held_percent")
    lines = []
    for each in names:
        held = [found.get((f"{name}/{each}", "object_held_percent")) for name in protocols]
        lines.append([each, *("-" if row is None else f"{row.value:.0f}" for row in held)])
    return markdown_table(["", *protocols], lines)


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
    """The report's text: one line for every fault, and what holds for all of them.

    Args:
        rows: Rows of ``summary.json``.
    """
    found = {(row.preset, row.name.removeprefix("faults.")): row for row in rows}
    lines = []
    for name in (*FAULTS, "all"):
        if (name, "crashes") not in found:
            continue
        cells = [
            "" if row is None else f"{row.value:.{digits}f}"
            for row, digits in ((found.get((name, key)), digits) for key, _, digits in _FAULTS)
        ]
        about = [FAULTS[name].what, FAULTS[name].behaviour] if name in FAULTS else ["", ""]
        mark = " *" if name in FAULTS and FAULTS[name].held else ""
        lines.append([f"`{name}`{mark}", *about, *cells, str(found[name, "crashes"].n)])
    heads = ["fault", "what goes wrong", "what the cell does", *(head for _, head, _ in _FAULTS)]
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
