"""The study of faults as Markdown: what each fault is, what the cell does, and what came of it."""

from __future__ import annotations

from collections.abc import Sequence

from feasigrasp.runs.results.rows import Row
from feasigrasp_lab.protocols.fault_table import FAULTS
from feasigrasp_lab.results.markdown import markdown_table

#: Figures of a fault: row name behind ``faults.``, heading, digits.
_COLUMNS = (
    ("held_percent", "held [%]", 0),
    ("named_percent", "held or named [%]", 0),
    ("noticed_s", "noticed after [s]", 2),
    ("limits_broken", "limits broken", 0),
    ("crashes", "crashes", 0),
)
#: What is said of the rows about an arm whose object is lost for good.
_RESTS = {
    "rest_s": "told to rest {:.2f} s after the stated silence or after a touch since then",
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
            for row, digits in ((found.get((name, key)), digits) for key, _, digits in _COLUMNS)
        ]
        about = [FAULTS[name].what, FAULTS[name].behaviour] if name in FAULTS else ["", ""]
        mark = " *" if name in FAULTS and FAULTS[name].held else ""
        lines.append([f"`{name}`{mark}", *about, *cells, str(found[name, "crashes"].n)])
    heads = ["fault", "what goes wrong", "what the cell does", *(head for _, head, _ in _COLUMNS)]
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
