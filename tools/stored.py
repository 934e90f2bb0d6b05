"""Stored rows of measured figures, ``feasigrasp_lab/results/*.json``, and those of the paper."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from feasigrasp.runs.metrics.table import METRICS
from feasigrasp_lab.protocols.tuned import TUNED
from feasigrasp_lab.report.paper_tables import (
    TABLE_1,
    TABLE_2,
    TABLE_2_COLUMNS,
    TABLE_3_JOINT,
    TABLE_3_TASK,
)
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.runs.summary import FIGURES

ROOT = Path(__file__).resolve().parents[1]
STORE = ROOT / "feasigrasp_lab" / "results"
#: Digits of all stored values; tables show at most 5.
_DIGITS = 5
#: Means that serve the inspection of single runs, and are not stored.
_MINOR = {f"dynamic.{name}" for name, metric in METRICS.items() if not metric.main}


class FigureError(ValueError):
    """A table that names something that is not stored, or a summary that cannot be stored."""


@dataclass(frozen=True)
class Stored:
    """The rows of one command.

    Attributes:
        command: Its command line.
        git: Its revision.
        commit: The number of that revision, counted from the first one.
        date: The date of that revision.
        rows: By row name and preset.
        more: Everything else: seed, versions, machine, conditions.
    """

    command: str
    git: str
    commit: int
    date: str
    rows: dict[tuple[str, str], Row] = field(repr=False)
    more: dict[str, Any] = field(default_factory=dict, repr=False)

    @property
    def kind(self) -> str:
        """Of its runs: by the ``camera`` alone, with the object's ``pose given``, or of ``paper``.

        The last are in the modes that repeat the paper. It is ``other`` without runs, or with both.
        """
        if "--study paper" in self.command:
            return "paper"
        tracking = self.more.get("conditions", {}).get("tracking")
        if not isinstance(tracking, str):
            return "other"
        return "camera" if tracking.startswith("in the camera's") else "pose given"

    def age(self, commit: int) -> str:
        """Revision and age, counted to a later commit."""
        if not self.git:
            return "arXiv:2311.02576"
        return f"{self.git[:7]}, age {commit - self.commit}"

    def summary(self) -> dict[str, Any]:
        """The content of a ``summary.json``."""
        rows = [row.__dict__ for row in self.rows.values()]
        return {"command": self.command, "git": self.git, **self.more, "rows": rows}


def read(name: str, folder: Path = STORE) -> Stored:
    """The stored rows of one command.

    Raises:
        FigureError: Nothing of that name is stored.
    """
    if name == "paper":
        return published()
    file = folder / f"{name}.json"
    if not file.exists():
        raise FigureError(f"{name} is not stored: python tools/figures.py store {name} FILE")
    content = json.loads(file.read_text())
    rows = {
        (row, preset): Row(row, preset, value, low, high, found["unit"], n, next(iter(tuned), None))
        for row, found in content.pop("rows").items()
        for preset, (value, low, high, n, *tuned) in found["presets"].items()
    }
    about = {key: content.pop(key) for key in ("command", "git", "commit", "date")}
    return Stored(**about, rows=rows, more=content)


def published() -> Stored:
    """The figures of the paper as rows, presets ``Circular/task space`` and ``paper``."""
    rows = [Row.plain("static.held_percent", "paper", TABLE_1[0], "%", 0)]
    for trajectory, methods in TABLE_2.items():
        for method, figures in methods.items():
            for name, (mean, _) in zip(TABLE_2_COLUMNS, figures, strict=True):
                preset = f"{trajectory}/{method}"
                rows.append(Row.plain(f"dynamic.{name}", preset, mean, FIGURES[name].unit, 5))
    for name, table in (("task_hz", TABLE_3_TASK), ("joint_hz", TABLE_3_JOINT)):
        rows += [Row.plain(f"bench.{name}.{k}", "paper", hz, "Hz", 0) for k, hz in table.items()]
    return Stored("", "", 0, "", {(row.name, row.preset): row for row in rows})


def names(folder: Path = STORE) -> list[str]:
    """The names of everything that is stored."""
    return sorted(file.stem for file in folder.glob("*.json"))


def store(name: str, file: Path, folder: Path = STORE) -> Path:
    """Stores the rows of a summary: those of groups of runs, and of single objects what was held.

    Raises:
        FigureError: It is a quick sample, or of a checkout with changes.
    """
    summary = json.loads(file.read_text())
    if summary.pop("quick", False) or summary.get("partial"):
        raise FigureError(f"{file} is a sample; run the whole command, without --quick")
    if not summary["git"] or summary["git"].endswith("-dirty"):
        raise FigureError(f"{file} is of revision {summary['git']}; commit, then measure")
    summary["command"] = re.sub(r" --(out|jobs) \S+", "", summary["command"])
    commit, date = commit_of(summary["git"])
    rows: dict[str, dict[str, Any]] = {}
    for row in map(lambda values: Row(**values), summary.pop("rows")):
        if row.name not in _MINOR and _is_kept(row):
            found = rows.setdefault(row.name, {"unit": row.unit, "presets": {}})
            values = (row.value, row.low, row.high)
            tuned = [] if row.tuned is None else [row.tuned]
            found["presets"][row.preset] = [*map(_rounded, values), row.n, *tuned]
    head = {key: summary.pop(key) for key in ("command", "git")}
    content = head | {"commit": commit, "date": date} | summary | {"rows": rows}
    text = json.dumps(content, indent=1)
    text = re.sub(r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: f"[{' '.join(m[1].split())}]", text)
    stored = folder / f"{name}.json"
    stored.write_text(text + "\n")
    return stored


def _is_kept(row: Row) -> bool:
    """Rows of groups of runs; of single objects, grasp success.

    Where a study changes its scenarios, what holds for all of them together; where it changes
    speeds, the points of the curves.
    """
    if not row.name.startswith("dynamic."):
        return True
    scenario, _, rest = row.preset.removeprefix(TUNED).partition("/")
    base, _, change = scenario.partition("-")
    speed = change.startswith(("at-", "spin-"))
    if rest.count("/") == 2:
        return row.name == "dynamic.held_percent" and base != "all" and (speed or not change)
    return not change or (base == "all" and not speed) or "/" not in rest


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.{_DIGITS}g}")


def commit_of(revision: str) -> tuple[int, str]:
    """The number of a revision, counted from the first one, and its date."""
    commands = (["rev-list", "--count", revision], ["show", "-s", "--format=%cs", revision])
    count, date = (
        subprocess.run(["git", *command], cwd=ROOT, capture_output=True, text=True, check=True)
        for command in commands
    )
    return int(count.stdout), date.stdout.strip()
