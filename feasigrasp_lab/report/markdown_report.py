"""``feasigrasp report DIR``: write the results of an evaluation or benchmark as Markdown.

Reads ``DIR/summary.json``, or those of the folders in DIR, and writes ``DIR/report.md``. The
dynamic and the static evaluation get the paper's tables beside their own, and figures; any other
summary a table of its rows. With ``--html`` it is a page as well.
"""

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from feasigrasp.errors import FeasigraspError, InputError, OutputError
from feasigrasp.inputs import read_json
from feasigrasp.outputs import write_text
from feasigrasp_lab.protocols.tuned import TUNED
from feasigrasp_lab.report.html_report import write_page
from feasigrasp_lab.report.tables import (
    FIGURE,
    dynamic_report,
    faults_report,
    markdown_table,
    static_report,
)
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.runs.run_plan import conditions_text


class ReportError(FeasigraspError, FileNotFoundError):
    """A folder without results."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument("folder", type=Path, metavar="DIR", help="Folder with summary.json.")
    parser.add_argument(
        "--html",
        action="store_true",
        help="Write DIR/report.html too: one page with figures, objects and the worst failures.",
    )
    parser.add_argument(
        "--replays",
        type=int,
        default=0,
        metavar="N",
        help="Number of the worst failures to run again and record for that page.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    parts = sections(args.folder)
    filename = args.folder / "report.md"
    write_text(filename, "\n\n".join(parts.values()) + "\n")
    print(filename)
    if args.html:
        print(write_page(args.folder, parts, args.replays))
    return 0


def sections(folder: Path) -> dict[Path, str]:
    """The text for each ``summary.json`` in a folder of results; figures are drawn beside it.

    Raises:
        ReportError: There are no results, or a summary is broken.
    """
    files = [folder / "summary.json"]
    if not files[0].exists():
        files = sorted(folder.glob("*/summary.json"))
    if not files:
        raise ReportError(
            f"neither {folder} nor a folder in it has a summary.json; give the --out of a command"
        )
    found = {}
    for file in files:
        try:
            section = _section(file)
        except OutputError:
            raise
        except (InputError, LookupError, TypeError, ValueError, AttributeError) as error:
            raise ReportError(
                f"{file} is no summary ({error!s:.200}); repeat the command that makes it"
            ) from error
        if file.parent != folder:  # every folder has figures of the same names
            section = re.sub(rf"\]\((tuned/)?({FIGURE})\)", rf"]({file.parent.name}/\1\2)", section)
        found[file] = section
    return found


def _section(file: Path) -> str:
    summary: dict[str, Any] = read_json(file)
    rows = [Row(**row) for row in summary["rows"]]
    found = summary.get("conditions")
    conditions = conditions_text(found) if found else ""
    tuned = [row for row in rows if row.preset.startswith(TUNED)]
    parts = [f"## `{summary['command']}`", _origin(summary)]
    parts.append(_body([row for row in rows if row not in tuned], file.parent, conditions))
    if tuned:
        plain = [replace(row, preset=row.preset.removeprefix(TUNED)) for row in tuned]
        part = _body(plain, file.parent / "tuned", conditions)
        part = part.replace(f"]({FIGURE})", f"](tuned/{FIGURE})")
        parts += ["## Runs that constants were chosen on", part]
    return "\n\n".join(parts)


def _body(rows: list[Row], folder: Path, conditions: str) -> str:
    if any(row.name.startswith("dynamic.") for row in rows):
        return dynamic_report(rows, folder, conditions)
    if any(row.name.startswith("faults.held") for row in rows):
        return faults_report(rows)
    if any(row.name.startswith("static.") for row in rows):
        return static_report(rows, conditions)
    return "\n\n".join(filter(None, [_plain_table(rows), conditions]))


def _origin(summary: dict[str, Any]) -> str:
    found = summary["versions"]
    versions = ", ".join(f"{n} {found[n]}" for n in ("python", "drake", "numpy") if n in found)
    quick = " A quick sample, no result to rely on." if summary.get("quick") else ""
    partial = " Broken off: not all runs are in it." if summary.get("partial") else ""
    return f"Revision {summary['git']}, seed {summary['seed']}; {versions}.{quick}{partial}"


def _plain_table(rows: list[Row]) -> str:
    lines = [
        [
            f"`{row.name}`",
            row.preset,
            f"{row.value:.4g}",
            "" if row.low is None else f"[{row.low:.4g}, {row.high:.4g}]",
            row.unit,
            str(row.n),
        ]
        for row in rows
    ]
    return markdown_table(["row", "preset", "value", "95 % interval", "unit", "n"], lines)
