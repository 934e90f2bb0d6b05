"""The files that ``feasigrasp evaluate`` and ``feasigrasp bench`` leave behind."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from feasigrasp.results.provenance import machine, versions
from feasigrasp.results.statistics import Estimate


@dataclass(frozen=True)
class Row:
    """One figure of a summary.

    Attributes:
        name: What is measured, e.g. ``dynamic.held_percent``.
        preset: Under which conditions, e.g. ``ReachLinear/task/safe``.
        value: The figure.
        low: Lower end of its 95 % interval; None without repeats.
        high: Upper end.
        unit: Its unit.
        n: Number of runs or samples behind it.
    """

    name: str
    preset: str
    value: float
    low: float | None
    high: float | None
    unit: str
    n: int

    @classmethod
    def of(cls, name: str, preset: str, estimate: Estimate, unit: str, factor: float = 1.0) -> Row:
        """A row from an estimate; ``factor`` converts its figures to ``unit``."""
        low, high = (
            None if bound is None else factor * bound for bound in (estimate.low, estimate.high)
        )
        return cls(name, preset, factor * estimate.value, low, high, unit, estimate.n)


def write_json(content: dict[str, Any], filename: Path) -> None:
    """Writes JSON, whole or not at all: a killed process leaves no half a file.

    Raises:
        ValueError: There is a NaN or an infinity in it, which JSON does not know.
    """
    filename.parent.mkdir(parents=True, exist_ok=True)
    partial = filename.with_name(f"{filename.name}.{os.getpid()}.part")
    partial.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
    partial.replace(filename)


def write_summary(
    filename: Path, command: str, git: str | None, seed: int, rows: Sequence[Row], **more: Any
) -> None:
    """Writes ``summary.json``, see ``docs/results_schema.md``.

    Args:
        filename: Where.
        command: The command line that made it.
        git: The revision it was made with.
        seed: Its seed.
        rows: The figures.
        **more: Further entries of the file, e.g. ``quick=True``.
    """
    content = {
        "command": command,
        "git": git,
        "seed": seed,
        "versions": versions(),
        "machine": machine(),
        **more,
        "rows": [asdict(row) for row in rows],
    }
    write_json(content, filename)
