"""Figures in README and docs that come from stored summaries; ``docs/developing.md`` says how.

``python tools/figures.py`` writes the figures and tables of all pages anew from the summaries in
``docs/summaries``; ``python tools/figures.py store NAME FILE`` stores the ``summary.json`` of a
command there. A test compares the pages with the summaries, and looks for figures without a mark.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from feasigrasp_lab.report import markdown_report

ROOT = Path(__file__).resolve().parents[1]
SUMMARIES = ROOT / "docs" / "summaries"

NUMBER = r"(?<![\w.,-])-?(?:\d{1,3}(?:[ ,]\d{3})+(?:\.\d+)?|\d+(?:\.\d+)?(?:e-?\d+)?)"
#: A figure of a summary: row, which entry of it, preset, factor to the unit of the text.
CELL = r"([\w.]+)(?:\[(low|high|n)\])?(?: ([^*{}<>]+?))?(?: \* ([\d.e-]+))?"
#: A number, its unit, and the comment that says where it comes from.
MARK = re.compile(rf"({NUMBER})([^\d\n|<]{{0,14}})<!-- (\w+): {CELL} -->")
#: A table that is made: names of summaries, and the lines that it is made by.
TABLE = re.compile(r"(<!-- table: ([\w, ]+)\n(.*?)\n-->\n).*?(<!-- table: end -->)", re.DOTALL)
#: The section that `feasigrasp report` writes, below the names of the summaries that it reads.
REPORT = re.compile(
    r"<!-- report of: ([\w, ]+) -->\n<!-- report: begin -->.*?<!-- report: end -->", re.DOTALL
)
CODE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)

Rows = Mapping[tuple[str, str], Mapping[str, Any]]


class FigureError(ValueError):
    """A mark or a table that names what no stored summary has."""


def pages() -> list[Path]:
    """Those that have measured figures."""
    return [ROOT / "README.md", ROOT / "docs" / "results.md", ROOT / "docs" / "results_schema.md"]


def read_rows(names: str, folder: Path = SUMMARIES) -> dict[tuple[str, str], dict[str, Any]]:
    """Rows of stored summaries, by name and preset.

    Args:
        names: Names of the summaries, separated by commas.
        folder: Where they are stored.

    Raises:
        FigureError: One of them is not there.
    """
    rows = {}
    for name in (part.strip() for part in names.split(",")):
        file = folder / f"{name}.json"
        if not file.exists():
            raise FigureError(f"there is no {file}: store it by tools/figures.py store {name} FILE")
        for row in json.loads(file.read_text())["rows"]:
            rows[row["name"], row["preset"]] = row
    return rows


def look_up(rows: Rows, row: str, field: str | None, preset: str, factor: str | None) -> float:
    """One figure, in the unit of the text.

    Raises:
        FigureError: There is none of that name, or it has no such entry.
    """
    found = rows.get((row, preset))
    if found is None:
        presets = ", ".join(p for name, p in rows if name == row) or "none"
        raise FigureError(f"no row {row} with preset '{preset}' is stored (presets: {presets})")
    value = found[field or "value"]
    if value is None:
        raise FigureError(f"row {row} with preset '{preset}' has no {field}")
    return float(value) * float(factor or 1.0)


def printed_like(text: str, value: float) -> str:
    """A value with as many digits as a number in a text, and its separator of thousands."""
    mantissa, _, exponent = text.partition("e")
    digits = len(mantissa.partition(".")[2])
    if exponent:
        head, _, tail = f"{value:.{digits}e}".partition("e")
        return f"{head}e{int(tail)}"
    separator = next((s for s in (",", " ") if s in text), "")
    # Adding zero makes -0.0 zero.
    return f"{round(value, digits) + 0.0:,.{digits}f}".replace(",", separator)


def update_marks(text: str, folder: Path = SUMMARIES) -> str:
    """A page with every marked number as its summary has it."""

    def renewed(match: re.Match[str]) -> str:
        number, unit, summary, row, field, preset, factor = match.groups()
        value = look_up(read_rows(summary, folder), row, field, preset or "", factor)
        return match[0].replace(number, printed_like(number, value), 1)

    return MARK.sub(renewed, text)


def update_tables(text: str, folder: Path = SUMMARIES) -> str:
    """A page with every table between its comments made anew."""

    def renewed(match: re.Match[str]) -> str:
        rows = read_rows(match[2], folder)
        return f"{match[1]}\n{made_table(match[3], rows)}\n\n{match[4]}"

    return TABLE.sub(renewed, text)


def made_table(template: str, rows: Rows) -> str:
    """A table by its template.

    The first line is the head. Every other line that begins with ``|`` is a template for the
    presets that are named below it, one a line; without any it stands for itself. ``{preset}`` is
    replaced by the preset, ``{0}``, ``{1}`` by its parts between slashes, and ``{row:format}`` or
    ``{row[low] another preset * factor:format}`` by a figure.
    """
    head, *rest = template.splitlines()
    lines = [head, "|" + "---|" * (head.count("|") - 1)]
    for number, line in enumerate(rest):
        if line.startswith("|"):
            below = rest[number + 1 :]
            count = next((k for k, other in enumerate(below) if other.startswith("|")), len(below))
            lines += [_filled(line, preset, rows) for preset in below[:count] or [""]]
    return "\n".join(lines)


def _filled(line: str, preset: str, rows: Rows) -> str:
    line = line.replace("{preset}", preset)
    line = re.sub(r"\{(\d)\}", lambda m: preset.split("/")[int(m[1])], line)

    def cell(match: re.Match[str]) -> str:
        row, field, other, factor, form = match.groups()
        return format(look_up(rows, row, field, other or preset, factor), form)

    return re.sub(rf"\{{{CELL}:([^{{}}:]+)\}}", cell, line)


def update_report(text: str, folder: Path = SUMMARIES) -> str:
    """A page with the section that ``feasigrasp report`` writes made anew."""
    match = REPORT.search(text)
    if match is None:
        return text
    with tempfile.TemporaryDirectory() as place:
        page, results = Path(place) / "page.md", Path(place) / "results"
        page.write_text(text)
        for name in match[1].split(", "):
            read_rows(name, folder)  # says what is missing
            (results / name).mkdir(parents=True)
            content = (folder / f"{name}.json").read_text()
            (results / name / "summary.json").write_text(content)
        markdown_report.main(argparse.Namespace(folder=results, into=page, html=False))
        return page.read_text()


def updated(text: str, folder: Path = SUMMARIES) -> str:
    """A page as the summaries have it; code in it stays as it is."""
    parts = CODE.split(update_report(text, folder))
    for k in range(0, len(parts), 2):  # code stands between
        parts[k] = update_tables(update_marks(parts[k], folder), folder)
    return "".join(parts)


def store(name: str, file: Path, folder: Path = SUMMARIES) -> Path:
    """Stores a summary, one row a line, without what is no condition of the result.

    Raises:
        FigureError: It is a quick sample, or of a checkout with changes: nothing to rely on.
    """
    summary = json.loads(file.read_text())
    if summary.get("quick"):
        raise FigureError(f"{file} is a quick sample; run the command without --quick")
    if not summary["git"] or summary["git"].endswith("-dirty"):
        raise FigureError(f"{file} is of revision {summary['git']}; commit, then measure")
    summary["command"] = re.sub(r" --(out|jobs) \S+", "", summary["command"])
    rows = ",\n  ".join(json.dumps(row) for row in summary.pop("rows"))
    head = json.dumps(summary, indent=1).removesuffix("\n}")
    folder.mkdir(exist_ok=True)
    stored = folder / f"{name}.json"
    stored.write_text(f'{head},\n "rows": [\n  {rows}\n ]\n}}\n')
    return stored


#: What makes a number a figure: its unit, or that it counts so many of so many.
UNITS = (
    r"%|[kM]?Hz|[mµu]?s|ms|minutes|hours|[kMG]i?B|mm|cm|m|mm/s|m/s|m²|m³|rad|rad/s|deg|degrees|°"
    r"|N|Nm|kg|g|times|of \d+"
)
FIGURE = re.compile(rf"{NUMBER}\s?(?:{UNITS})(?![\w/])")
#: What is no figure of ours: code, links, what is made or marked, and numbers said to be settings.
NO_FIGURE = (
    CODE,
    REPORT,
    TABLE,
    MARK,
    re.compile(rf"{NUMBER}[^\d\n|<]{{0,14}}<!-- set -->"),
    re.compile(r"`[^`]*`"),
    re.compile(r"\[[^\]\n]*\]\([^)]*\)"),
    re.compile(r"<!--.*?-->", re.DOTALL),
    re.compile(r"\b(?:19|20)\d\d\b"),
)
SETTINGS = "<!-- settings -->"


def unmarked(text: str) -> list[tuple[str, int, str]]:
    """Measured figures of a page that neither have a mark nor are in a table that is made.

    Numbers with a unit, and all numbers in tables, count. Not looked at are code, whatever stands
    between the line ``<!-- settings -->`` and the next heading (below the page's title: the whole
    page), and a number behind which a comment ``set`` stands.

    Returns:
        The heading that each stands below, its line, and what stands there.
    """
    text = _without_settings(text)
    for pattern in NO_FIGURE:
        text = pattern.sub(lambda match: re.sub(r"[^\n]", " ", match[0]), text)
    found, heading = [], ""
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("#"):
            heading = line.lstrip("# ")
        pattern = re.compile(NUMBER) if line.startswith("|") else FIGURE
        found += [(heading, number, match[0]) for match in pattern.finditer(line)]
    return found


def _without_settings(text: str) -> str:
    """A page with empty lines where its numbers are said to be settings."""
    kept: list[str] = []
    whole_page, section, headings, code = False, False, 0, False
    for line in text.splitlines():
        code ^= line.startswith("```")
        if line.startswith("#") and not code:
            headings, section = headings + 1, False
        if line.strip() == SETTINGS:
            whole_page, section = whole_page or headings <= 1, True
        kept.append("" if whole_page or section else line)
    return "\n".join(kept)


def main() -> int:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("store", nargs="*", metavar="store NAME FILE", help="store a summary")
    words = parser.parse_args().store
    try:
        if words:
            if len(words) != 3 or words[0] != "store":
                parser.error("expected: store NAME FILE")
            print(store(words[1], Path(words[2])))
        for page in pages():
            page.write_text(updated(page.read_text()))
    except FigureError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
