"""``feasigrasp evaluate gallery``: record a replay for every row of the dynamic table.

Writes ``DIR/index.html``, with every replay as ``DIR/<name>.html`` and the record of its run as
``DIR/<name>.json``. The paper's scenarios are shown for one lap. Where a Chromium is found, the
page gets a picture of every replay.
"""

import argparse
import html
from collections.abc import Sequence
from importlib import resources
from string import Template

from tqdm import tqdm

from feasigrasp.outputs import write_text
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp.scenario.sampling import lap
from feasigrasp_lab.report.screenshot import take_picture
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.finished import Record
from feasigrasp_lab.runs.isolated import report_crashes, run_all
from feasigrasp_lab.runs.plan import PlannedRun, add_plan_arguments, plan

#: Columns of the page: metric, heading, digits.
_COLUMNS = (
    ("gripper_object_distance_cm_mean", "distance [cm]", 2),
    ("manipulability_mean", "manipulability", 3),
    ("joint_limit_violation_percent", "joint limits violated [%]", 1),
    ("self_collision_percent", "self-collision [%]", 1),
    ("grasp_held", "held", 0),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/gallery", objects=None)
    add_plan_arguments(parser, default="all")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    runs = shown(plan(args).runs)
    records = run_all(runs, args.out, args.jobs, desc="gallery", replays=True)
    pictures = {
        planned.id
        for planned in tqdm(runs, unit="picture", desc="pictures")
        if take_picture(args.out / f"{planned.id}.html")
    }
    page = args.out / "index.html"
    write_text(page, index_page(runs, records, pictures))
    print(page)
    return report_crashes(records)


def shown(runs: Sequence[PlannedRun]) -> list[PlannedRun]:
    """The first object and seed of every scenario, controller and mode; at most one lap."""
    first: dict[tuple[str, str, str], PlannedRun] = {}
    for planned in runs:
        scenario = planned.scenario
        if not scenario.grasp.close:
            scenario.simulation_duration = min(scenario.simulation_duration, lap(scenario))
        control = scenario.control
        first.setdefault((planned.name, control.controller, control.mode), planned)
    return list(first.values())


def index_page(runs: Sequence[PlannedRun], records: Sequence[Record], pictures: set[str]) -> str:
    """The page as HTML text."""
    cards = []
    for planned, record in zip(runs, records, strict=True):
        control = planned.scenario.control
        figures = [
            f"<dt>{html.escape(head)}</dt><dd>{_text(record['metrics'][name], digits)}</dd>"
            for name, head, digits in _COLUMNS
            if record["metrics"][name] is not None
        ]
        picture = (
            f'<img src="{planned.id}.png" alt="the arm at the start" loading="lazy">'
            if planned.id in pictures
            else '<span class="play">play</span>'
        )
        cards.append(
            f'<a class="card" href="{planned.id}.html">{picture}'
            f"<h2>{html.escape(planned.name)}</h2>"
            f"<p>{control.controller} space, {control.mode} mode, "
            f"{html.escape(planned.object_name)}</p><dl>{''.join(figures)}</dl></a>"
        )
    page = resources.files("feasigrasp_lab.studies").joinpath("gallery.html").read_text()
    return Template(page).substitute(
        cards="\n".join(cards), revision=html.escape(str(git_revision()))
    )


def _text(value: float | bool, digits: int) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.{digits}f}"
