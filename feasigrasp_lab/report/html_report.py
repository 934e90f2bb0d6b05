"""Report of a result folder as one self-contained HTML page.

It has what `feasigrasp_lab.report.markdown_report` writes, with its figures inside, below each
result every object and how often it was held, and the worst failures of all with links to their
replays.
"""

import base64
import html
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from math import isfinite
from pathlib import Path
from string import Template
from urllib.parse import quote

from feasigrasp.errors import InputError
from feasigrasp.inputs import read_json
from feasigrasp.outputs import write_text
from feasigrasp.scenario.files import parse_scenario
from feasigrasp_lab.protocols.tuned import TUNED
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.statistics import grouped
from feasigrasp_lab.runs.isolated import run_isolated

#: Objects, each with how often it was held, and in how many runs.
Outcomes = Mapping[str, tuple[int, int]]


def write_page(folder: Path, sections: Mapping[Path, str], replays: int = 0) -> Path:
    """Writes ``report.html`` into a folder of results.

    Args:
        folder: The folder.
        sections: The report on each ``summary.json`` in it, or in folders in it, as Markdown; its
            images are named as seen from the folder.
        replays: Of so many of the worst failures without a replay one is made, by running them
            again.
    """
    records, before = _records(folder), "data:image/png;base64,"
    images = {
        file.relative_to(folder).as_posix(): before + base64.b64encode(file.read_bytes()).decode()
        for file in sorted(folder.rglob("*.png"))
    }
    parts = []
    for summary, text in sections.items():
        runs = [run for file, run in records.items() if file.parent.parent == summary.parent]
        held = outcomes_of_runs(runs) or outcomes_of_rows(_rows(summary))
        parts += [markdown_html(text, images), objects_part(held)]
    if records:
        parts.append(_failures_part(folder, records, replays))
    template = resources.files("feasigrasp_lab.report").joinpath("report.html").read_text()
    page = folder / "report.html"
    write_text(page, Template(template).substitute(body="\n".join(filter(None, parts))))
    return page


def _records(folder: Path) -> dict[Path, Record]:
    """The runs of all results in a folder that close the hand, by their files."""
    found = {}
    for file in sorted([*folder.glob("runs/*.json"), *folder.glob("*/runs/*.json")]):
        try:
            record = read_json(file)
            if record["metrics"]["grasp_held"] is not None:
                found[file] = record
        except (InputError, LookupError, TypeError):
            continue  # some other file that happens to lie there
    return found


def _rows(summary: Path) -> list[Row]:
    """Its rows that are shares of something."""
    rows = [Row(**row) for row in read_json(summary)["rows"]]
    return [row for row in rows if row.unit == "%" and row.n > 0 and isfinite(row.value)]


def outcomes_of_runs(records: Sequence[Record]) -> Outcomes:
    """How often every object was held, and in how many runs."""
    found = grouped(records, lambda run: str(run["object"]))
    return {
        model: (sum(bool(run["metrics"]["grasp_held"]) for run in runs), len(runs))
        for model, runs in found.items()
    }


def outcomes_of_rows(rows: Sequence[Row]) -> Outcomes:
    """The same by the rows of a summary, whose runs are not there any more."""
    found: dict[str, tuple[int, int]] = {}
    for row in rows:
        *condition, model = row.preset.removeprefix(TUNED).split("/")
        dynamic = row.name == "dynamic.held_percent" and len(condition) == 3
        whole = dynamic and condition[0].startswith("all")  # has these runs once more
        if (dynamic and not whole) or row.name == "static.object_held_percent":
            held, runs = found.get(model, (0, 0))
            found[model] = held + round(row.value * row.n / 100.0), runs + row.n
    return found


def objects_part(outcomes: Outcomes) -> str:
    """Every object, those that are held least often first; empty without any."""
    cards = []
    for model, (held, runs) in sorted(outcomes.items(), key=lambda item: item[1][0] / item[1][1]):
        share = 100.0 * held / runs
        cards.append(
            f"<figure><figcaption>{html.escape(Path(model).stem)}"
            f'<span class="bar"><i style="width:{share:.0f}%"></i></span>'
            f"{held} of {runs} held</figcaption></figure>"
        )
    shown = f'<h3>Objects</h3>\n<div class="objects">{"".join(cards)}</div>'
    return shown if cards else ""


def worst_failures(records: Mapping[Path, Record]) -> list[Path]:
    """The files of runs that did not hold: those that broke off first, then the farthest pushed."""
    lost = [file for file, run in records.items() if not run["metrics"]["grasp_held"]]

    def badness(file: Path) -> tuple[bool, float]:
        run = records[file]
        return run["error"] is not None, run["metrics"]["pushed_mm"] or 0.0

    # Failures that the page lists.
    return sorted(lost, key=badness, reverse=True)[:12]


def _failures_part(folder: Path, records: Mapping[Path, Record], replays: int) -> str:
    lines = []
    for file in worst_failures(records):
        run, replay = records[file], file.with_suffix(".html")
        if replays and not replay.exists():
            scenario = parse_scenario(run["scenario_yaml"])
            run_isolated(scenario, run["scenario"], file.with_suffix(".again.json"), replay=replay)
            file.with_suffix(".again.json").unlink()
            replays -= 1
        link = "not recorded; <code>feasigrasp report DIR --html --replays N</code> makes some"
        if replay.exists():
            link = f'<a href="{quote(replay.relative_to(folder).as_posix())}">replay</a>'
        metrics, pushed = run["metrics"], run["metrics"]["pushed_mm"]
        cells = (
            *(str(run[key]) for key in ("scenario", "controller")),
            *(Path(run["object"]).stem, str(run["seed"]), str(metrics["cause"]).replace("_", " ")),
            *("-" if pushed is None else f"{pushed:.0f}", (run["error"] or "-")[:200]),
        )
        texts = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        lines.append(f"<tr>{texts}<td>{link}</td></tr>")
    if not lines:
        return "<h3>The worst failures</h3>\n<p>Every run held its object.</p>"
    heads = ("run", "controller", "object", "seed", "why", "pushed [mm]", "error", "replay")
    head = "".join(f"<th>{each}</th>" for each in heads)
    return f"<h3>The worst failures</h3>\n<table><tr>{head}</tr>{''.join(lines)}</table>"


def markdown_html(text: str, images: Mapping[str, str]) -> str:
    """The Markdown that commands write, as HTML: headings, tables, images, code, bold, text.

    The images are what stands for them in the page, by their names in the text.
    """
    return "\n".join(_block_html(block, images) for block in text.strip().split("\n\n"))


def _block_html(block: str, images: Mapping[str, str]) -> str:
    if heading := re.fullmatch(r"(#+) (.*)", block):
        level = len(heading[1])
        return f"<h{level}>{_inline_html(heading[2])}</h{level}>"
    if image := re.fullmatch(r"!\[(.*)\]\((.*)\)", block):
        source = images.get(image[2], image[2])
        return f'<img src="{html.escape(source)}" alt="{html.escape(image[1])}">'
    if block.startswith("| "):
        head, _, *lines = [line[2:-2].split(" | ") for line in block.splitlines()]
        rows = [_row_html("th", head), *(_row_html("td", line) for line in lines)]
        return f'<div class="wide"><table>{"".join(rows)}</table></div>'
    return f"<p>{_inline_html(block)}</p>"


def _row_html(tag: str, cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<{tag}>{_inline_html(cell)}</{tag}>' for cell in cells)}</tr>"


def _inline_html(text: str) -> str:
    escaped = re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text))
    return re.sub(r"\*\*([^*]*)\*\*", r"<strong>\1</strong>", escaped)
