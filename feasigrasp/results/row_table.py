"""The rows of a summary as text."""

from __future__ import annotations

from collections.abc import Sequence

from feasigrasp.results.rows import Row


def format_rows(rows: Sequence[Row]) -> str:
    """One line per row: name, preset, value with its interval, unit, number of samples."""
    names = max((len(row.name) for row in rows), default=0)
    presets = max((len(row.preset) for row in rows), default=0)
    lines = []
    for row in rows:
        bounds = "" if row.low is None else f"[{row.low:.4g}, {row.high:.4g}]"
        lines.append(
            f"{row.name:{names}s}  {row.preset:{presets}s}  {row.value:10.4g} {row.unit:6s}"
            f" {bounds:24s} n = {row.n}"
        )
    return "\n".join(lines)
