"""Measured figures of README and docs, from the rows in ``feasigrasp_lab/results``.

``python tools/figures.py`` fills the tables of the pages, and draws the curves of success over
speed. ``store NAME FILE`` stores the ``summary.json`` of a command first, and ``store DIR`` those
of ``evaluate all``. ``check`` names the figures of pages that this code might not give again.
A page has a table between the comments
``<!-- table: NAME -->`` and ``<!-- end -->``; ``tools/tables.yaml`` says what is in it:

- ``columns``: rows of summaries, with ``HEADING =`` before where it is not their standard term, or
  one of `VIRTUAL`, or ``*NAME`` for the columns in ``_NAME``. Each of the ``lines`` is a stored
  file and a preset, which may have wildcards. A column that no line has is named below the table.
- or ``presets``: columns are presets, and each of the ``lines`` is a stored file and a row.

A line has a label if it is not the preset. ``{1}`` in it is the second part of the preset, and
``{0:all-}`` the first one without this beginning. ``+`` puts several figures into one cell. Below a
table stand revision and age, unless there is a column for those.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import yaml

from feasigrasp.runs.metrics.table import UNITLESS
from feasigrasp_lab.report.tables import draw_curves
from feasigrasp_lab.runs.summary import FIGURES
from tools.runtime import changed_since
from tools.same_runs import stands_for
from tools.stored import ROOT, STORE, FigureError, Stored, commit_of, read, store

PAGES = (ROOT / "README.md", ROOT / "docs" / "results.md", ROOT / "docs" / "safety.md")
TABLES = Path(__file__).with_name("tables.yaml")
#: The picture of success over speed, and the stored rows that it shows, with their curves.
PICTURE = ROOT / "docs" / "images" / "speed_curve.png"
_CURVES = {
    "dynamic_speed_circle": "circle",
    "dynamic_speed_camera": "circle-camera",
    "dynamic_bezier_camera": "bezier-camera",
    "dynamic_spin": "spin",
}
NOT_MEASURED = ""
_TABLE = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)
_AGES = re.compile(r"Ages are in commits before number (\d+), of ([\d-]+)\.")


def filled(text: str, commit: int, date: str) -> str:
    """A page with its tables from the stored rows.

    Args:
        text: The page.
        commit: The commit that ages are counted to.
        date: Its date.
    """
    tables = yaml.safe_load(TABLES.read_text())

    def table(match: re.Match[str]) -> str:
        if match[2] not in tables:
            raise FigureError(f"{TABLES} has no table {match[2]}")
        return f"{match[1]}\n{made(tables[match[2]], commit)}\n\n{match[3]}"

    text = _AGES.sub(f"Ages are in commits before number {commit}, of {date}.", text)
    return _TABLE.sub(table, text)


def made(table: Mapping[str, Any], commit: int, folder: Path = STORE) -> str:
    """A table by its entry in `TABLES`.

    Raises:
        FigureError: It names what is not stored.
    """
    sources: dict[str, Stored] = {}
    lines = list(_lines(table["lines"], sources, folder))
    if "columns" in table:
        rows = _by_preset(_columns(table["columns"]), lines, commit)
        rows, missing = _without_missing(rows)
    else:
        rows, missing = _by_row(table["presets"].split(", "), lines, commit), []
    text = _markdown(rows)
    if "revision and age" not in rows[0]:
        ages: dict[str, list[str]] = {}
        for name, source in sources.items():
            ages.setdefault(source.age(commit), []).append(f"`{name}`")
        text += "\n\n" + "; ".join(f"{', '.join(of)}: {age}" for age, of in ages.items()) + "."
        if missing:
            text += f" Not measured: {', '.join(missing)}."
    return text


def _columns(text: str) -> list[str]:
    """The columns of a table, with those that more than one table has."""
    shared = yaml.safe_load(TABLES.read_text())
    return re.sub(r"\*(\w+)", lambda match: str(shared[f"_{match[1]}"]), text).split(", ")


def _without_missing(rows: list[list[str]]) -> tuple[list[list[str]], list[str]]:
    """A table without the columns that were measured in no line, and the headings of those."""
    columns = list(zip(*rows, strict=True))
    missing = [column for column in columns if {*column[1:]} <= {NOT_MEASURED}]
    kept = [list(row) for row in zip(*(c for c in columns if c not in missing), strict=True)]
    return kept, [column[0].partition(" [")[0] for column in missing]


def sources() -> str:
    """What `PICTURE` is drawn from: files and revisions."""
    return ", ".join(f"{name} {read(name).git}" for name in _CURVES)


def draw() -> None:
    """Draws `PICTURE` from the stored rows."""
    found = {
        (preset, name.removeprefix("dynamic.")): row
        for stored in _CURVES
        for (name, preset), row in read(stored).rows.items()
    }
    draw_curves(found, list(_CURVES.values()), PICTURE, sources())


def counted_to(text: str) -> tuple[int, str]:
    """The commit that the ages of a page are counted to, and its date."""
    match = _AGES.search(text)
    if match is None:
        raise FigureError("the page does not say 'Ages are in commits before number N, of DATE.'")
    return int(match[1]), match[2]


#: A line of a table: label, and the files and presets, or rows, whose figures share its cells.
_Line = tuple[str, list[tuple[Stored, str]]]


class _Part(str):
    """A part of a preset, in a label: its format is a beginning that is left out."""

    def __format__(self, beginning: str) -> str:
        return self.removeprefix(beginning)


def _lines(
    lines: Iterable[str | Mapping[str, str]], sources: dict[str, Stored], folder: Path
) -> Iterator[_Line]:
    """The lines of a table; files that they are from are added to ``sources``."""
    for line in lines:
        ((label, what),) = line.items() if isinstance(line, Mapping) else [("", line)]
        matches = []
        for part in what.split(" + "):
            name, _, pattern = part.partition(" ")
            stored = sources.setdefault(name, read(name, folder))
            there = dict.fromkeys(word for key in stored.rows for word in key)
            found = [w for w in there if fnmatch(w, pattern) and w.count("/") == pattern.count("/")]
            if not found:
                raise FigureError(f"{name} has neither row nor preset {pattern}")
            matches.append([(stored, word) for word in found])
        for cells in zip(*matches, strict=True):
            word = cells[0][1]
            parts = map(_Part, word.split("/"))
            yield label.format(*parts) or word.removesuffix("/safe"), list(cells)


def _by_preset(columns: list[str], lines: list[_Line], commit: int) -> list[list[str]]:
    """Columns are rows of summaries."""
    heads, names = zip(*map(_column, columns), strict=True)
    table = [["", *heads]]
    for label, sources in lines:
        cells = []
        for name in names:
            make = VIRTUAL.get(
                name, lambda stored, preset, _, name=name: _cell(stored, name, preset)
            )
            texts = [make(stored, preset, commit) for stored, preset in sources]
            cells.append(" / ".join(dict.fromkeys(texts) if {*texts} == {NOT_MEASURED} else texts))
        table.append([label, *cells])
    return table


def _by_row(columns: list[str], lines: list[_Line], _: int) -> list[list[str]]:
    """Columns are presets; all that match are in one cell, named if the column has a wildcard."""
    heads, patterns = zip(*map(_column, columns), strict=True)
    table = [["", *heads]]
    for label, sources in lines:
        cells = []
        for pattern in patterns:
            texts = []
            for stored, name in sources:
                found = [p for n, p in stored.rows if n == name and fnmatch(p, pattern)]
                for preset in found:
                    unit = stored.rows[name, preset].unit
                    text = f"{_cell(stored, name, preset)} {'' if unit in UNITLESS else unit}"
                    whose = f"{preset.rpartition(':')[2]} " if "*" in pattern else ""
                    texts.append(f"{whose}{text}".rstrip())
            cells.append(", ".join(texts) or "-")
        table.append([label, *cells])
    return table


def _column(text: str) -> tuple[str, str]:
    """Heading and name of a column."""
    head, _, name = text.rpartition(" = ")
    figure = FIGURES.get(name)
    if figure is not None or name.startswith("cause."):
        term = figure.head if figure is not None else name
        return head or f"{term} `{name}`", f"dynamic.{name}"
    return head or name, name


def _cell(stored: Stored, name: str, preset: str) -> str:
    """A value, for grasp success with its interval."""
    of_static = name.replace("dynamic.", "static.")
    row = stored.rows.get((name, preset)) or stored.rows.get((of_static, preset))
    if row is None:
        metric = name.removeprefix("dynamic.") in FIGURES and "change" not in name
        return NOT_MEASURED if metric else "-"
    if row.tuned is None and name.endswith(".held_percent") and stored.git:
        raise FigureError(
            f"{preset} of {stored.command}: constants were chosen on some of its runs"
        )
    figure = FIGURES.get(name.removeprefix("dynamic."))
    if figure is not None:
        text = figure.text(row.value + 0.0)
    else:
        text = f"{row.value:.3g}" if abs(row.value) < 1e3 else f"{row.value:,.0f}"
    success = name.endswith(".held_percent")
    return f"{text} ({row.low:.0f} - {row.high:.0f})" if success and row.low is not None else text


def _runs(stored: Stored, preset: str, _: int) -> str:
    """The number of runs."""
    return str(max(row.n for (_, other), row in stored.rows.items() if other == preset) or "-")


def _failures(stored: Stored, preset: str, _: int) -> str:
    """How many runs failed for each cause."""
    counts = {
        name.split(".")[2].removesuffix("_percent").replace("_", " "): row.value * row.n / 100.0
        for (name, other), row in stored.rows.items()
        if other == preset and name.split(".")[1] == "cause"
    }
    found = sorted(((round(n), cause) for cause, n in counts.items() if n > 0.5), reverse=True)
    return ", ".join(f"{cause} {n}" for n, cause in found) or ("none" if counts else "-")


def _lost(stored: Stored, preset: str, _: int) -> str:
    """How many grasps of each object failed."""
    scenario, controller, mode = preset.split("/")
    pattern = f"{scenario.replace('all', '*')}/{controller.replace('all', '*')}/{mode}/*"
    counts: Counter[str] = Counter()
    for (name, other), row in stored.rows.items():
        if name == "dynamic.held_percent" and fnmatch(other, pattern):
            counts[other.rpartition("/")[2].replace("_", " ")] += round(
                row.n * (1 - row.value / 100)
            )
    return ", ".join(f"{what} {n}" for what, n in counts.most_common() if n) or "none"


def _tuned(stored: Stored, preset: str, _: int) -> str:
    """Whether constants were chosen on the runs."""
    row = next(row for (_, other), row in stored.rows.items() if other == preset)
    return "yes" if row.tuned else "no"


def _age(stored: Stored, _: str, commit: int) -> str:
    return stored.age(commit)


def _success(stored: Stored, preset: str, _: int) -> str:
    """Grasp success of any command."""
    return next(_cell(stored, *key) for key in stored.rows if _is_success(*key, preset))


def _is_success(name: str, other: str, preset: str) -> bool:
    return name.endswith(".held_percent") and other == preset


def outdated(page: str) -> dict[str, list[str]]:
    """Stored files of a page's tables whose runs' code has changed since, with the paths.

    A later revision that gave the same reference runs of its kind stands for that of the file.

    Raises:
        subprocess.CalledProcessError: A revision is not in the repository.
    """
    tables = yaml.safe_load(TABLES.read_text())
    sources: dict[str, Stored] = {}
    for _, name, _ in _TABLE.findall(page):
        list(_lines(tables[name]["lines"], sources, STORE))
    since = {
        name: stands_for(stored.git, stored.kind) for name, stored in sources.items() if stored.git
    }
    changed = {git: changed_since(git) for git in {*since.values()}}
    return {name: changed[git] for name, git in since.items() if changed[git]}


#: Columns that are no rows of summaries.
VIRTUAL: dict[str, Callable[[Stored, str, int], str]] = {
    "grasp success [%]": _success,
    "runs": _runs,
    "failures": _failures,
    "failed objects": _lost,
    "constants chosen on them": _tuned,
    "revision and age": _age,
}


def _markdown(rows: list[list[str]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def main() -> int:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("store", nargs="*", metavar="store [NAME] FILE", help="store a summary")
    words = parser.parse_args().store
    try:
        if words == ["check"]:
            found = outdated("".join(page.read_text() for page in PAGES))
            for name, paths in found.items():
                print(f"{name} was measured before {len(paths)} files changed: {paths[0]}, ...")
            return int(bool(found))
        if words:
            if words[0] != "store" or len(words) not in (2, 3):
                parser.error("expected: store NAME FILE, or store DIR")
            folder = Path(words[1])
            of_all = {file.parent.name: file for file in sorted(folder.glob("*/summary.json"))}
            for name, file in of_all.items() if len(words) == 2 else [(words[1], Path(words[2]))]:
                print(store(name, file))
        for page in PAGES:
            page.write_text(filled(page.read_text(), *commit_of("HEAD")))
        draw()
    except FigureError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
