"""Markdown that commands write."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from feasigrasp.errors import FeasigraspError
from feasigrasp.outputs import write_text

#: Between these lines, `replace_section` writes.
BEGIN, END = "<!-- report: begin -->", "<!-- report: end -->"


class SectionError(FeasigraspError, ValueError):
    """A document without a place for a report."""


def markdown_table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """A table; every line has as many cells as ``heads``."""
    rows = [list(heads), ["---"] * len(heads), *map(list, lines)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in rows)


def replace_section(filename: Path, text: str) -> None:
    """Replaces what stands between the lines `BEGIN` and `END` of a document.

    Raises:
        SectionError: The document, or one of the two lines, is missing.
    """
    try:
        before, rest = filename.read_text().split(BEGIN)
        _, after = rest.split(END)
    except (FileNotFoundError, ValueError) as error:
        raise SectionError(
            f"{filename} must exist and have one line '{BEGIN}' and, after it, one line '{END}'"
        ) from error
    write_text(filename, f"{before}{BEGIN}\n\n{text.strip()}\n\n{END}{after}")
