"""``feasigrasp evaluate segmentation``: compare the first mask, by depth alone, with the true one.

A command that was interrupted goes on after its last object.
"""

from __future__ import annotations

import argparse
from operator import itemgetter

import numpy as np

from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import add_common_arguments, names, positive, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp.runs.results.statistics import grouped
from feasigrasp.scenario.files import load_scenario
from feasigrasp_lab.measures.first_mask import first_mask_iou
from feasigrasp_lab.results.finished import Record, finish_all

SCENARIOS = "ReachCircular,ReachLinear,ReachSinusoidal"
#: Bottles, cans, tools, thin walls, fruit: of each kind of the built-in objects.
OBJECTS = (
    "mustard_bottle,soup_can,small_box,mug,drill,bowl,banana,screwdriver,hammer,apple,cup,l_block"
)
#: What ``--quick`` looks at.
_QUICK = ("drill", "mug", "small_box")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/segmentation", objects=OBJECTS)
    parser.add_argument(
        "--scenarios", type=names, default=names(SCENARIOS), help="Scenarios, separated by commas."
    )
    parser.add_argument(
        "--seeds", type=positive, default=3, help="Number of starts of each object."
    )


def first_masks(name: str, path: str, scenarios: list[str], seeds: int, seed: int) -> list[Record]:
    """The first mask of an object from every seed; the scenarios take turns.

    Args:
        name: Of the object.
        path: What is loaded.
        scenarios: Names of packaged scenarios.
        seeds: How many starts.
        seed: Of the first.
    """
    filename = diagram_path("dynamic.scenarios.yaml")
    found = []
    for number in range(seed, seed + seeds):
        scenario_name = scenarios[number % len(scenarios)]
        text = f"{{random_seed: {number}, object: {{model: {path!r}}}}}"
        iou = first_mask_iou(load_scenario(filename, scenario_name, text))
        found.append({"scenario": scenario_name, "object": name, "seed": number, "iou": iou})
    return found


def mask_rows(raw: list[Record]) -> list[Row]:
    """The rows ``tracking.first_mask_iou.*``, of all starts and of each object."""
    groups = {"all": raw} | grouped(raw, itemgetter("object"))
    rows = []
    for preset, group in groups.items():
        ious = [start["iou"] for start in group]
        for figure, value in (("median", np.median(ious)), ("least", min(ious))):
            name = f"tracking.first_mask_iou.{figure}"
            rows.append(Row.plain(name, preset, value, "", len(ious)))
    return rows


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = select_objects(args.objects)
    if args.quick:
        objects = {name: path for name, path in objects.items() if name in _QUICK} or objects
    settings = {"scenarios": args.scenarios, "seeds": args.seeds, "seed": args.seed}
    finished = finish_all(
        objects, args.out / "objects", settings, first_masks, jobs=args.jobs, desc="first masks"
    )
    raw = [record for name in objects for record in finished[name]]
    write_csv(args.out / "first_masks.csv", raw)
    report_rows(args, "evaluate segmentation", mask_rows(raw))
    return 0
