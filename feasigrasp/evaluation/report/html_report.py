"""A folder of results as one page that needs nothing beside it.

It has what `feasigrasp.evaluation.report.markdown_report` writes, with its figures inside, and what
only a page can show: every object with its picture and how often it was held, and the worst
failures with links to their replays.
"""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from urllib.parse import quote

from matplotlib.image import imsave

from feasigrasp.errors import FeasigraspError, InputError
from feasigrasp.evaluation.runs.isolated import run_isolated
from feasigrasp.inputs import read_json
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.outputs import write_text
from feasigrasp.results.finished import Record
from feasigrasp.results.markdown import markdown_html
from feasigrasp.results.statistics import grouped
from feasigrasp.scenario.files import parse_scenario
from feasigrasp.training.data.shape_sheet import shape_picture

#: Failures that the page lists.
_WORST = 12


def write_page(folder: Path, text: str, replays: int = 0) -> Path:
    """Writes ``report.html`` into a folder of results.

    Args:
        folder: The folder.
        text: The report as Markdown; its images are files in the folder or in one of its folders.
        replays: Of so many of the worst failures without a replay one is made, by running them
            again.

    Returns:
        The file.
    """
    records = _records(folder)
    images = {
        file.relative_to(folder).as_posix(): _data(file.read_bytes())
        for file in sorted(folder.rglob("*.png"))
    }
    parts = [markdown_html(text, images)]
    if records:
        parts += [objects_part(list(records.values())), _failures_part(folder, records, replays)]
    template = resources.files("feasigrasp.evaluation.report").joinpath("report.html").read_text()
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


def objects_part(records: Sequence[Record]) -> str:
    """Every object with its picture, those that are held least often first."""
    held = {
        model: [bool(run["metrics"]["grasp_held"]) for run in runs]
        for model, runs in grouped(records, lambda run: str(run["object"])).items()
    }
    cards = []
    for model, outcomes in sorted(held.items(), key=lambda item: sum(item[1]) / len(item[1])):
        share = 100.0 * sum(outcomes) / len(outcomes)
        cards.append(
            f"<figure>{_picture(model)}<figcaption>{html.escape(Path(model).stem)}"
            f'<span class="bar"><i style="width:{share:.0f}%"></i></span>'
            f"{sum(outcomes)} of {len(outcomes)} held</figcaption></figure>"
        )
    return f'<h3>Objects</h3>\n<div class="objects">{"".join(cards)}</div>'


def _picture(model: str) -> str:
    """The object, if it is still there to be looked at."""
    try:
        pixels = shape_picture(load_object(model))
    except FeasigraspError:
        return '<span class="nothing">no mesh</span>'
    file = io.BytesIO()
    imsave(file, pixels.clip(0.0, 1.0), format="png")
    return f'<img src="{_data(file.getvalue())}" alt="{html.escape(Path(model).stem)}">'


def worst_failures(records: Mapping[Path, Record]) -> list[Path]:
    """The files of runs that did not hold: those that broke off first, then the farthest pushed."""
    lost = [file for file, run in records.items() if not run["metrics"]["grasp_held"]]

    def badness(file: Path) -> tuple[bool, float]:
        run = records[file]
        return run["error"] is not None, run["metrics"]["pushed_mm"] or 0.0

    return sorted(lost, key=badness, reverse=True)[:_WORST]


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
        told = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        lines.append(f"<tr>{told}<td>{link}</td></tr>")
    if not lines:
        return "<h3>The worst failures</h3>\n<p>Every run held its object.</p>"
    heads = ("run", "controller", "object", "seed", "why", "pushed [mm]", "error", "replay")
    head = "".join(f"<th>{each}</th>" for each in heads)
    return f"<h3>The worst failures</h3>\n<table><tr>{head}</tr>{''.join(lines)}</table>"


def _data(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"
