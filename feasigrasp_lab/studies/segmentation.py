"""``feasigrasp evaluate segmentation``: compare the first mask, by depth alone, with the true one.

A command that was interrupted goes on after its last object.
"""

import argparse
from copy import deepcopy
from operator import itemgetter

import numpy as np
from pydrake.math import RigidTransform

from feasigrasp.models.arrays import Mask
from feasigrasp.models.objects.tracking import Tracking, TrackingState
from feasigrasp.models.robot.gripper_file import load_gripper
from feasigrasp.models.segmentation.foreground import Label
from feasigrasp.resources import diagram_path
from feasigrasp.runs.results.arguments import positive
from feasigrasp.scenario.files import load_scenario
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.from_scenario import make_foreground_segmentation, make_station
from feasigrasp.systems.ports import to_value
from feasigrasp_lab.results.arguments import add_common_arguments, select_objects
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped


def intersection_over_union(mask: Mask, truth: Mask) -> float:
    """Pixels in both masks as a share of those in either; 1 if both are empty."""
    either = np.count_nonzero(mask | truth)
    return np.count_nonzero(mask & truth) / either if either else 1.0


def first_mask_iou(scenario: Scenario) -> float:
    """Intersection over union of the object's first mask with its true one, in [0, 1].

    Nothing of the object is known: no field, no pose, no earlier view. Where several bodies are
    seen none is taken for it yet, since nothing has moved: 0. Pixels without a depth count
    in neither mask, since nothing is measured there.

    Args:
        scenario: Object, motion, seed, camera and its errors.
    """
    scenario, camera = deepcopy(scenario), scenario.perception.camera
    scenario.cameras[camera].output_delay = 0.0  # so that the first image is there at once
    station = make_station(scenario)
    foreground = make_foreground_segmentation(scenario, load_gripper(scenario.gripper))
    at_start, context = station.CreateDefaultContext(), foreground.CreateDefaultContext()
    cloud = station.GetOutputPort(f"{camera}.point_cloud").Eval(at_start)
    for name, value in (
        ("point_cloud", cloud),
        ("camera_pose", station.GetOutputPort(f"{camera}.pose").Eval(at_start)),
        ("position", station.GetOutputPort("arm.position_measured").Eval(at_start)),
        ("gripper_state", station.GetOutputPort("gripper.state_measured").Eval(at_start)),
        ("object_pose", RigidTransform(np.full((3, 4), np.nan))),
        ("tracking", Tracking(TrackingState.SEARCHING, np.inf)),
        ("gpdf", to_value(None)),
        ("color_image", station.GetOutputPort(f"{camera}.color_image").Eval(at_start)),
    ):
        foreground.GetInputPort(name).FixValue(context, value)
    labels = foreground.GetOutputPort("label_image").Eval(context).data[:, :, 0]
    true_labels = station.GetOutputPort(f"{camera}.label_image").Eval(at_start).data[:, :, 0]
    measured = np.isfinite(cloud.xyzs()).all(axis=0).reshape(labels.shape)
    truth = true_labels == int(station.object_body.index())
    return intersection_over_union((labels == Label.OBJECT) & measured, truth & measured)


#: The scenarios, which take turns.
SCENARIOS = ("ReachCircular", "ReachLinear", "ReachSinusoidal")
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
        "--seeds", type=positive, default=3, help="Number of starts of each object."
    )


def first_masks(name: str, path: str, seeds: int, seed: int) -> list[Record]:
    """The first mask of an object from every seed; the scenarios take turns.

    Args:
        name: Of the object.
        path: What is loaded.
        seeds: How many starts.
        seed: Of the first.
    """
    filename = diagram_path("dynamic.scenarios.yaml")
    found = []
    for number in range(seed, seed + seeds):
        scenario_name = SCENARIOS[number % len(SCENARIOS)]
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
    settings = {"seeds": args.seeds, "seed": args.seed}
    raw = finish_all(
        objects, args.out / "objects", settings, first_masks, jobs=args.jobs, desc="first masks"
    )
    write_csv(args.out / "first_masks.csv", raw)
    report_rows(args, "evaluate segmentation", mask_rows(raw))
    return 0
