"""The table of ablations: what is lost without each part of the system."""

from __future__ import annotations

from feasigrasp_lab.protocols.ablations import ABLATIONS, FULL, ablation_of
from feasigrasp_lab.report.table_2 import Rows, figure_text
from feasigrasp_lab.results.markdown import markdown_table

_COLUMNS = (
    ("held_percent", "held [%]", 1),
    ("held_change_percent", "change [%]", 1),
    ("held_after_s", "time to hold [s]", 2),
    ("held_after_change_s", "change [s]", 2),
    ("pushed_percent", "pushed [%]", 1),
)


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
            rows = [(found.get((preset, column)), digits) for column, _, digits in _COLUMNS]
            cells = ["-" if row is None else figure_text(row, digits) for row, digits in rows]
            runs = found[preset, "held_percent"].n
            lines.append([name, controller, *cells, str(runs)])
    if not lines:
        return ""
    heads = ["", "controller", *(head for _, head, _ in _COLUMNS), "runs"]
    text = (
        "Changes are those of the same object, scenario and seed against everything; of times, "
        "where both held. Intervals are of objects drawn anew."
    )
    return "\n\n".join(["### Ablations", markdown_table(heads, lines), text, conditions])
