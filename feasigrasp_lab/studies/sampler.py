"""``feasigrasp evaluate sampler``: judge grasps of held-out objects.

Every object is looked at from random directions by a noisy depth camera, completed as perception
does it, and the grasps that the samplers offer are judged on the true mesh; the best ones are tried
in a floating-gripper simulation. All presets see the same clouds: ``default`` (the network),
``paper`` (the paper's architecture, same data; candidates of ``antipodal`` join in for either
network where few grasps are left), ``antipodal`` (no network) and the baseline ``diffusion``. What
each figure means is written in docs/results_schema.md. A command that was interrupted goes on after
its last object.
"""

import argparse
import zlib
from collections.abc import Sequence
from functools import lru_cache
from operator import itemgetter

import numpy as np
import torch

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.baselines.diffusion_sampler import DiffusionSampler
from feasigrasp_lab.paper.grasp_network import NETWORKS, trained_network
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import grouped, resampled
from feasigrasp_lab.runs.floating_gripper import FloatingGripper
from feasigrasp_lab.training.data.grasp_examples import fuse_and_complete, true_input
from feasigrasp_lab.training.data.grasp_labels import is_graspable
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.held_out_objects import (
    DEFAULT_OBJECTS,
    held_out_objects,
    make_object,
)
from feasigrasp_lab.training.data.views import ViewedObject, turning_views

#: Number of views by condition.
CONDITIONS = {"1view": 1, "3views": 3}
GRIPPER = ParallelGripper()
_ABOUT = ("object", "graspable", "view", "condition", "preset")
#: Columns of the raw files, by kind of record.
_COLUMNS = {
    "set": (*_ABOUT, "grasps", "valid", "antipodal", "free", "top_valid"),
    "hold": (*_ABOUT, "held", "why"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_sampler", objects=DEFAULT_OBJECTS)
    parser.add_argument(
        "--views", type=positive, default=2, help="Number of first views of every object."
    )
    parser.add_argument(
        "--generated", type=positive, default=40, help="Number of shapes of the held-out families."
    )


@lru_cache(maxsize=1)
def make_samplers() -> dict[str, GraspSamplerFn]:
    """The samplers by preset."""
    samplers: dict[str, GraspSamplerFn] = {
        preset: NetworkSampler(GRIPPER, trained_network(preset)) for preset in NETWORKS
    }
    return samplers | {
        "antipodal": AntipodalSampler(GRIPPER),
        "diffusion": DiffusionSampler(GRIPPER),
    }


def evaluate_object(name: str, what: str, views: int, seed: int) -> list[Record]:
    """Measures all views, conditions and presets of one object.

    Args:
        name: Of the object; seeds its views, with ``seed``.
        what: See `make_object`.
        views: Number of first views; the best grasps of the very first alone are simulated.
        seed: Of the views.

    Returns:
        Records with ``kind``: "set" (what `set_measures` returns for a sampler's grasps), "hold"
        (one simulated grasp).
    """
    torch.set_num_threads(1)
    obj = make_object(what)
    viewed, truth = ViewedObject(obj), TrueGrasps(obj.mesh)
    code = zlib.crc32(name.encode())
    perfect = true_input(truth, np.random.default_rng([seed, code]))
    base: Record = {"object": name, "graspable": int(is_graspable(truth, perfect, GRIPPER))}
    records = []
    for view in range(views):
        rng = np.random.default_rng([seed, code, view])
        cameras = turning_views(rng, viewed.center, max(CONDITIONS.values()))
        seen = [viewed.view(X_OC, rng) for X_OC in cameras]
        for condition, count in CONDITIONS.items():
            about = base | {"view": view, "condition": condition}
            field = fuse_and_complete(seen[:count])
            for preset, sampler in make_samplers().items():
                record: Record = {"kind": "set", "preset": preset}
                records.append(about | record | set_measures(sampler(field), truth))
            if condition == "1view" and view == 0:
                records += [about | record for record in _hold(obj, field)]
    return records


def set_measures(grasps: GraspSet, truth: TrueGrasps) -> Record:
    """How many grasps of a filtered set are truly valid.

    Returns:
        ``grasps``, their number; ``valid``, how many are antipodal and free on the true mesh;
        ``antipodal`` and ``free`` alone; ``top_valid``, whether the best one is (None without one).
    """
    antipodal = truth.truly_antipodal(grasps.X_OG, GRIPPER.max_opening)
    free = truth.hand_free(grasps.X_OG, GRIPPER)
    valid = antipodal & free
    return {
        "grasps": len(grasps),
        "valid": int(valid.sum()),
        "antipodal": int(antipodal.sum()),
        "free": int(free.sum()),
        "top_valid": int(valid[0]) if len(valid) else None,
    }


def _hold(obj: RigidObject, field: Gpdf) -> list[Record]:
    """Simulates the best grasp of every preset."""
    hand, records = FloatingGripper(obj, GRIPPER), list[Record]()
    for preset, sampler in make_samplers().items():
        for X_OG in sampler(field).X_OG[:1]:
            trial = hand.try_grasp(X_OG)
            about: Record = {"kind": "hold", "preset": preset}
            records.append(about | {"held": int(trial.held), "why": trial.why})
    return records


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = held_out_objects(args.objects, args.generated, args.seed)
    views = 1 if args.quick else args.views
    if args.quick:
        objects = dict(list(objects.items())[:: -(-len(objects) // 8)])
    settings = {"views": views, "seed": args.seed}
    records = finish_all(
        objects, args.out / "objects", settings, evaluate_object, jobs=args.jobs, desc="sampler"
    )
    for kind, columns in _COLUMNS.items():
        write_csv(args.out / f"{kind}s.csv", _of(records, kind), columns, ".6g")
    report_rows(args, "evaluate sampler", summary_rows(records))
    return 0


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """All rows; intervals are of objects drawn anew, of shares by `share_of_objects`."""
    rows = []
    for preset, of_preset in grouped(records, itemgetter("preset")).items():
        for condition, found in grouped(_of(of_preset, "set"), itemgetter("condition")).items():
            by_object = list(grouped(found, itemgetter("object")).values())
            precision = resampled(by_object, _precision)
            rows.append(Row.of(f"sampler.precision.{condition}", preset, precision, "1"))
            tops = [r for r in found if r["top_valid"] is not None]
            name = f"sampler.top1_valid_percent.{condition}"
            rows.append(_share(name, preset, tops, [r["top_valid"] for r in tops]))
            graspable = [r for r in found if r["graspable"]]
            # Coverage is asked for with one view; other conditions are named.
            name = "sampler.coverage_percent" + (condition != "1view") * f".{condition}"
            rows.append(_share(name, preset, graspable, [r["valid"] > 0 for r in graspable]))
        holds = [r for r in _of(of_preset, "hold") if r["graspable"]]
        if holds:
            held = [r["held"] for r in holds]
            rows.append(_share("sampler.held_top1_percent", preset, holds, held))
    return rows


def _share(name: str, preset: str, records: Sequence[Record], outcomes: Sequence[bool]) -> Row:
    return Row.percent(name, preset, outcomes, [record["object"] for record in records])


def _of(records: Sequence[Record], kind: str) -> list[Record]:
    return [record for record in records if record["kind"] == kind]


def _precision(objects: Sequence[Sequence[Record]]) -> float:
    """The share of all offered grasps of some objects that are valid."""
    records = [record for of_object in objects for record in of_object]
    offered = sum(record["grasps"] for record in records)
    return sum(record["valid"] for record in records) / offered if offered else float("nan")
