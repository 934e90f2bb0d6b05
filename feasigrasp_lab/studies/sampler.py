"""``feasigrasp evaluate sampler``: judge grasps of held-out objects.

Every object is looked at from random directions by a noisy depth camera, completed as perception
does it, and the grasps that the samplers offer are judged on the true mesh; some are tried in a
floating-gripper simulation. All presets see the same clouds: ``default`` (the network), ``paper``
(the paper's architecture, same data), ``antipodal`` (no network). The candidates of ``antipodal``
join in for either network where few grasps are left; ``default.alone`` and ``paper.alone`` are the
networks without them. ``diffusion`` is the baseline, ``diffusion.unfiltered`` all of its samples as
they are drawn. What each figure means is written in docs/results_schema.md. A command that was
interrupted goes on after its last object.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from pathlib import Path

import numpy as np
import torch

from feasigrasp.models.grasps.antipodal import AntipodalSampler
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.network.surface_input import grasp_input
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.objects.rigid_object import RigidObject
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.baselines.diffusion_sampler import DiffusionSampler
from feasigrasp_lab.measures.diffusion_score import score_error
from feasigrasp_lab.measures.grasps import (
    equivariance_error,
    is_graspable,
    proposal_measures,
    set_measures,
)
from feasigrasp_lab.measures.timing import cpu_ms
from feasigrasp_lab.paper.grasp_network import NETWORKS, trained_network
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import average_precision, grouped, resampled
from feasigrasp_lab.runs.floating_gripper import hold_trials
from feasigrasp_lab.training.data.grasp_examples import fuse_and_complete, true_input
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.held_out_objects import (
    DEFAULT_OBJECTS,
    held_out_objects,
    make_object,
)
from feasigrasp_lab.training.data.views import ViewedObject, turning_views

#: Samplers whose grasps are simulated; networks among them; and how a network is called that gets
#: no candidates of others.
PRESETS = ("default", "paper", "antipodal", "diffusion")
ALONE = "{}.alone"
#: How all samples of the baseline are called.
UNFILTERED = "diffusion.unfiltered"
#: Number of views by condition.
CONDITIONS = {"1view": 1, "3views": 3}
#: Generated objects, views of every object, and views of which grasps are simulated. Source:
#: definition.
GENERATED, VIEWS, HELD_VIEWS = 40, 2, 1
QUICK_OBJECTS = 8
#: Friction of object and fingers in the simulation. Source: definition.
FRICTION = 0.6
GRIPPER = ParallelGripper()
#: Columns of the raw files, by kind of record.
_COLUMNS = {
    "set": ("grasps", "valid", "antipodal", "free", "top_valid", "cpu_ms"),
    "hold": ("choice", "held", "why"),
    "proposal": ("contacts", "contact_ap", "width_mm", "closing_deg", "approach_percent"),
}
_ABOUT = ("object", "graspable", "view", "condition", "preset")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_sampler", objects=DEFAULT_OBJECTS)
    parser.add_argument(
        "--views", type=positive, default=VIEWS, help="Number of first views of every object."
    )
    parser.add_argument(
        "--generated",
        type=positive,
        default=GENERATED,
        help="Number of shapes of the held-out families.",
    )


@lru_cache(maxsize=1)
def make_samplers() -> dict[str, GraspSamplerFn]:
    """The samplers by preset."""
    samplers: dict[str, GraspSamplerFn] = {
        "antipodal": AntipodalSampler(GRIPPER),
        "diffusion": DiffusionSampler(GRIPPER),
    }
    for preset in NETWORKS:
        network = trained_network(preset)
        samplers[preset] = NetworkSampler(GRIPPER, network)
        samplers[ALONE.format(preset)] = NetworkSampler(GRIPPER, network, top_up=False)
    return samplers


def evaluate_object(name: str, what: str, views: int, held_views: int, seed: int) -> list[Record]:
    """Measures all views, conditions and presets of one object.

    Args:
        name: Of the object; seeds its views.
        what: See `make_object`.
        views: Number of first views.
        held_views: In so many of them grasps of a single view are simulated.
        seed: Of the views.

    Returns:
        Records with ``kind``: "set" (what `set_measures` returns for a sampler's grasps),
        "proposal" (what `proposal_measures` returns for a network), "hold" (one simulated grasp).
    """
    torch.set_num_threads(1)
    obj = make_object(what)
    viewed, truth = ViewedObject(obj), TrueGrasps(obj.mesh)
    code = zlib.crc32(name.encode())
    perfect = true_input(truth, np.random.default_rng([seed, code]))
    base: Record = {"object": name, "graspable": int(is_graspable(truth, perfect, GRIPPER))}
    records = []
    for preset in NETWORKS:
        network = trained_network(preset)
        about: Record = {"kind": "proposal", "preset": preset, "view": 0, "condition": "true"}
        record = proposal_measures(network, perfect, truth, GRIPPER, seed)
        record["equivariance_error"] = equivariance_error(network, perfect, code)
        records.append(base | about | record)
    for view in range(views):
        rng = np.random.default_rng([seed, code, view])
        cameras = turning_views(rng, viewed.center, max(CONDITIONS.values()))
        seen = [viewed.view(X_OC, rng) for X_OC in cameras]
        for condition, count in CONDITIONS.items():
            about = base | {"view": view, "condition": condition}
            field = fuse_and_complete(seen[:count])
            records += [about | r for r in _judge_field(field, truth, seed, condition == "1view")]
            if condition == "1view" and view < held_views:
                records += [about | r for r in _hold(obj, field, code)]
    return records


def _judge_field(field: Gpdf, truth: TrueGrasps, seed: int, proposals: bool) -> list[Record]:
    """Records of all presets on one field."""
    records: list[Record] = []

    def judge(preset: str, grasps: GraspSet, cpu: float) -> None:
        record: Record = {"kind": "set", "preset": preset, "cpu_ms": cpu}
        record |= set_measures(grasps, truth, GRIPPER) | {"rejected": dict(grasps.rejected)}
        records.append(record)

    for preset, sampler in make_samplers().items():
        _ = field.completion
        if isinstance(sampler, DiffusionSampler):  # drawn once, for both presets
            (X_OG, width, _), drawing = cpu_ms(partial(sampler.candidates, field))
            judge(UNFILTERED, GraspSet(X_OG, width, np.ones(len(width))), drawing)
            grasps, cpu = cpu_ms(partial(sampler.judged, field, X_OG))
            judge(preset, grasps, drawing + cpu)
            continue
        judge(preset, *cpu_ms(partial(sampler, field)))
        if proposals and preset in NETWORKS:
            network = trained_network(preset)
            measured = proposal_measures(network, grasp_input(field), truth, GRIPPER, seed)
            records.append({"kind": "proposal", "preset": preset} | measured)
    return records


def _hold(obj: RigidObject, field: Gpdf, seed: int) -> list[Record]:
    """Simulates the best grasp of every preset and one drawn from the filtered ones."""
    records: list[Record] = []
    for preset in PRESETS:
        grasps: GraspSet = make_samplers()[preset](field)
        if len(grasps) == 0:
            continue
        drawn = int(np.random.default_rng(seed).integers(len(grasps)))
        verdicts = hold_trials(obj, grasps.X_OG[[0, drawn]], GRIPPER, friction=FRICTION)
        for choice, verdict in zip(("top1", "random"), verdicts, strict=True):
            about: Record = {"kind": "hold", "preset": preset, "choice": choice}
            records.append(about | {"held": int(verdict.held), "why": verdict.why})
    return records


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    # Deviations of the noise that the baseline's directions are compared with a known mixture at
    # [rad and units of length], and poses.
    noise, noised_poses = (0.03, 0.2, 0.7), 200_000
    objects = held_out_objects(args.objects, args.generated, args.seed)
    views = args.views
    if args.quick:
        objects = dict(list(objects.items())[:: -(-len(objects) // QUICK_OBJECTS)])
        views = 1
    settings = {"views": views, "held_views": HELD_VIEWS, "seed": args.seed}
    finished = finish_all(
        objects, args.out / "objects", settings, evaluate_object, jobs=args.jobs, desc="sampler"
    )
    records = [record for name in objects for record in finished[name]]
    write_records(records, args.out)
    rows = summary_rows(records)
    for deviation in noise:
        error = score_error(deviation, noised_poses, args.seed)
        rows.append(
            Row.plain("diffusion.score_error", f"targets/{deviation}", error, "1", noised_poses)
        )
    report_rows(args, "evaluate sampler", rows)
    return 0


def summary_rows(records: Sequence[Record]) -> list[Row]:
    """All rows; intervals are of objects drawn anew, of shares by `share_of_objects`."""
    rows = []
    for preset, of_preset in grouped(records, itemgetter("preset")).items():
        for condition, name in (("1view", "completed"), ("true", "true")):
            found = _of(of_preset, "proposal", condition=condition)
            if not found:
                continue
            rows.append(_pooled(f"sampler.contact_ap.{name}", preset, found, _ap, "1"))
            suffix = "" if name == "completed" else ".true"
            for what, statistic, unit in (
                ("width_mm", _WIDTH, "mm"),
                ("closing_deg", _CLOSING, "deg"),
                ("approach_valid_percent", _APPROACH, "%"),
            ):
                rows.append(_pooled(f"sampler.{what}{suffix}", preset, found, statistic, unit))
        for condition in ("1view", "3views"):
            found = _of(of_preset, "set", condition=condition)
            if not found:
                continue
            name = f"sampler.precision.{condition}"
            rows.append(_pooled(name, preset, found, _precision, "1"))
            rows.append(_pooled(f"{name}.per_view", preset, found, _precision_per_view, "1"))
            tops = [r for r in found if r["top_valid"] is not None]
            name = f"sampler.top1_valid_percent.{condition}"
            rows.append(_share(name, preset, tops, [r["top_valid"] for r in tops]))
            graspable = [r for r in found if r["graspable"]]
            # Coverage is asked for with one view; other conditions are named.
            suffix = (condition != "1view") * f".{condition}"
            # So many grasps are a choice, whether they are true or not.
            for name, counted in (
                ("sampler.coverage_percent", [r["valid"] > 0 for r in graspable]),
                ("sampler.ten_offered_percent", [r["grasps"] >= 10 for r in graspable]),
            ):
                rows.append(_share(name + suffix, preset, graspable, counted))
        for choice in ("top1", "random"):
            holds = [r for r in _of(of_preset, "hold", choice=choice) if r["graspable"]]
            if holds:
                held = [r["held"] for r in holds]
                rows.append(_share(f"sampler.held_{choice}_percent", preset, holds, held))
        errors = [r["equivariance_error"] for r in of_preset if "equivariance_error" in r]
        if errors:
            name = "sampler.equivariance.f64"
            rows.append(Row.plain(name, preset, max(errors), "1", len(errors)))
    return rows


def _share(name: str, preset: str, records: Sequence[Record], outcomes: Sequence[bool]) -> Row:
    return Row.percent(name, preset, outcomes, [record["object"] for record in records])


def write_records(records: Sequence[Record], folder: Path) -> None:
    """Writes ``sets.csv``, ``proposals.csv`` and ``holds.csv``, one line per record."""
    for kind, columns in _COLUMNS.items():
        found = _of(records, kind)
        lines = [r | _proposal_figures(r) for r in found] if kind == "proposal" else found
        write_csv(folder / f"{kind}s.csv", lines, (*_ABOUT, *columns), ".6g")


def _of(records: Sequence[Record], kind: str, **where: str) -> list[Record]:
    wanted = {"kind": kind, **where}.items()
    return [record for record in records if all(record[key] == value for key, value in wanted)]


def _pooled(
    name: str,
    preset: str,
    records: Sequence[Record],
    statistic: Callable[[Sequence[Record]], float],
    unit: str,
) -> Row:
    by_object = list(grouped(records, itemgetter("object")).values())
    estimate = resampled(by_object, lambda groups: statistic([r for g in groups for r in g]))
    return Row.of(name, preset, estimate, unit)


def _joined(records: Sequence[Record], column: str) -> np.ndarray:
    return np.array([value for record in records for value in record[column]], dtype=float)


def _ap(records: Sequence[Record]) -> float:
    return average_precision(_joined(records, "contact"), _joined(records, "is_contact") > 0.5)


def _of_column(
    column: str, reduce: Callable[[np.ndarray], np.floating], factor: float
) -> Callable[[Sequence[Record]], float]:
    """A statistic of all values of a column; NaN without any."""

    def statistic(records: Sequence[Record]) -> float:
        values = _joined(records, column)
        return factor * float(reduce(values)) if len(values) else float("nan")

    return statistic


_WIDTH = _of_column("width_error", np.median, 1e3)
_CLOSING = _of_column("closing_error", np.median, 1.0)
_APPROACH = _of_column("approach_free", np.mean, 100.0)


def _precision(records: Sequence[Record]) -> float:
    offered = sum(record["grasps"] for record in records)
    return sum(record["valid"] for record in records) / offered if offered else float("nan")


def _precision_per_view(records: Sequence[Record]) -> float:
    shares = [record["valid"] / record["grasps"] for record in records if record["grasps"]]
    return float(np.mean(shares)) if shares else float("nan")


def _proposal_figures(record: Record) -> Record:
    one = [record]
    return {
        "contacts": sum(record["is_contact"]),
        "contact_ap": _ap(one),
        "width_mm": _WIDTH(one),
        "closing_deg": _CLOSING(one),
        "approach_percent": _APPROACH(one),
    }
