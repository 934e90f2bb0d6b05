"""``feasigrasp evaluate grasp-labels``: simulate the grasps that training labels call valid.

Grasps start at random points of the true surfaces of generated shapes of all families. Half of them
are valid by the label; the hand of the other half is free as well, but the closing line leaves the
friction cone of a face. A floating gripper tries every one: closes, lifts, shakes.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Mapping

import numpy as np
import trimesh

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.runs.results.arguments import add_common_arguments, positive, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.finished import Record, finish_all
from feasigrasp_lab.runs.floating_gripper import hold_trials
from feasigrasp_lab.training.data.grasp_labels import find_pairs
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.household_shapes import FAMILIES, make_shape

#: Seeds of the shapes start here, far from those of any training stream.
FIRST_SEED = 900_000_000
FRICTION = 0.6
_POINTS = 300
#: Half angle of the cone in which closing directions of invalid grasps are drawn [deg].
_WIDE_DEG = 50.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_grasp_labels", objects=None)
    parser.add_argument(
        "--shapes", type=positive, default=3, help="Number of shapes of every family."
    )
    parser.add_argument(
        "--grasps", type=positive, default=6, help="Number of grasps of every object."
    )


def sample_grasps(
    truth: TrueGrasps, gripper: ParallelGripper, count: int, rng: np.random.Generator
) -> tuple[Array, Mask, Array]:
    """Grasps of one object whose hand is free, half of them valid.

    Returns:
        X_OG (n, 4, 4), whether they are valid (n,), and the lesser cosine at their faces (n,); n
        may be less than ``count``.
    """
    points, faces = trimesh.sample.sample_surface(truth.mesh, _POINTS, seed=rng)
    normals = np.asarray(truth.mesh.face_normals[faces])
    pairs = find_pairs(truth, np.asarray(points), normals, gripper, rng)
    some = rng.permutation(len(pairs.point))[: count - count // 2]
    turned = pairs.turned()
    middle = pairs.contact + 0.5 * pairs.width[:, None] * pairs.closing
    valid = [
        _frame(pairs.closing[i], turned[i, rng.choice(np.flatnonzero(pairs.free[i]))], middle[i])
        for i in some
    ]
    skew = _skew_lines(truth, np.asarray(points), normals, gripper, rng)
    candidates = np.array(valid + skew).reshape(-1, 4, 4)
    free = truth.hand_free(candidates, gripper)
    closed = truth.close(candidates, gripper.max_opening)
    is_valid = free & truth.truly_antipodal(candidates, gripper.max_opening)
    is_skew = np.arange(len(candidates)) >= len(valid)
    good = np.flatnonzero(is_valid & ~is_skew)
    bad = np.flatnonzero(free & ~is_valid & np.isfinite(closed.width) & is_skew)
    chosen = np.concatenate([good, bad[: count // 2]])
    return candidates[chosen], is_valid[chosen], closed.cosine[chosen]


def try_object(name: str, what: tuple[str, int] | str, grasps: int, seed: int) -> list[Record]:
    """Tries grasps of one object, given by family and seed or by its file; one record each."""
    obj = load_object(what) if isinstance(what, str) else make_shape(*what)
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    gripper = ParallelGripper()
    X_OG, valid, cosine = sample_grasps(TrueGrasps(obj.mesh), gripper, grasps, rng)
    trials = hold_trials(obj, X_OG, gripper, friction=FRICTION)
    return [
        {"object": name, "valid": bool(v), "cosine": float(c), "held": t.held, "why": t.why}
        | {"turn_deg": None if np.isnan(t.turn_deg) else t.turn_deg}
        for v, c, t in zip(valid, cosine, trials, strict=True)
    ]


def summary_rows(records: list[Record]) -> list[Row]:
    """Shares held of valid and other grasps, and how often label and simulation agree."""
    rows = []
    for preset, wanted in (("valid", True), ("not antipodal", False)):
        group = [r["held"] for r in records if r["valid"] == wanted]
        if group:
            rows.append(Row.percent("labels.held_percent", preset, group))
    agree = [r["held"] == r["valid"] for r in records]
    if agree:
        rows.append(Row.percent("labels.agreement_percent", "all", agree))
    turns = [r["turn_deg"] for r in records if r["valid"] and r["held"]]
    if turns:
        turned = float(np.median(turns))
        rows.append(Row.plain("labels.turn_deg.median", "valid", turned, "deg", len(turns)))
    return rows


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    shapes, grasps = (1, 4) if args.quick else (args.shapes, args.grasps)
    objects: Mapping[str, tuple[str, int] | str]
    if args.objects is not None:
        objects = select_objects(args.objects)
    else:
        objects = {
            f"{family}_{i}": (family, FIRST_SEED + 1000 * args.seed + i)
            for family in FAMILIES
            for i in range(shapes)
        }
    settings = {"grasps": grasps, "seed": args.seed}
    finished = finish_all(
        objects, args.out / "objects", settings, try_object, jobs=args.jobs, desc="grasp labels"
    )
    records = [r for name in objects for r in finished[name]]
    write_csv(
        args.out / "grasps.csv", records, ("object", "valid", "cosine", "held", "why", "turn_deg")
    )
    report_rows(args, "evaluate grasp-labels", summary_rows(records))
    return 0


def _skew_lines(
    truth: TrueGrasps,
    points: Array,
    normals: Array,
    gripper: ParallelGripper,
    rng: np.random.Generator,
) -> list[Array]:
    """Grasp frames (4, 4) at surface points whose closing directions are well off the normals."""
    b = -normals + np.tan(np.deg2rad(_WIDE_DEG)) * rng.uniform(size=(len(points), 1)) * _unit(
        rng.normal(size=points.shape)
    )
    b = _unit(b)
    length, _ = truth.cast(points - 1e-5 * normals, b)
    approach = _unit(np.cross(b, rng.normal(size=points.shape)))
    return [
        _frame(b[i], approach[i], points[i] + 0.5 * length[i] * b[i])
        for i in np.flatnonzero(length < gripper.max_opening)
    ]


def _frame(x: Array, z: Array, origin: Array) -> Array:
    return se3.make_pose(np.stack([x, np.cross(z, x), z], axis=-1), origin)


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit
