"""``feasigrasp evaluate grasp-labels``: do grasps that the labels call valid hold in simulation?

Grasps start at random points of the true surfaces of generated shapes of all families. Half of them
are valid by the label; the hand of the other half is free as well, but the closing line leaves the
friction cone of a face. A floating gripper tries every one: closes, lifts, shakes.
"""

from __future__ import annotations

import argparse
import csv
import shlex
import zlib
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import trimesh
from tqdm import tqdm

from feasigrasp.evaluation.runs.floating_gripper import hold_trials
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.objects.rigid_object import RigidObject, load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.results.arguments import add_common_arguments, positive, select_objects
from feasigrasp.results.finished import finished_records
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.row_table import format_rows
from feasigrasp.results.rows import Row, write_json, write_summary
from feasigrasp.results.statistics import proportion
from feasigrasp.training.data.grasp_labels import find_pairs
from feasigrasp.training.data.grasp_truth import TrueGrasps
from feasigrasp.training.data.household_shapes import FAMILIES, make_shape

Record = dict[str, Any]

#: Seeds of the shapes start here, far from those of any training stream.
FIRST_SEED = 900_000_000
FRICTION = 0.6
_POINTS = 300
#: Half angle of the cone in which closing directions of invalid grasps are drawn [deg].
_WIDE_DEG = 50.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/evaluate_grasp_labels", objects=None)
    parser.add_argument("--shapes", type=positive, default=3, help="shapes of every family")
    parser.add_argument("--grasps", type=positive, default=6, help="grasps of every object")


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
    valid = [
        _frame(
            pairs.closing[i],
            turned[i, rng.choice(np.flatnonzero(pairs.free[i]))],
            pairs.contact[i] + 0.5 * pairs.width[i] * pairs.closing[i],
        )
        for i in some
    ]
    skew = _skew_lines(truth, np.asarray(points), normals, gripper, rng)
    candidates = np.array(valid + skew).reshape(-1, 4, 4)
    free = truth.hand_free(candidates, gripper)
    closed = truth.close(candidates, gripper.max_opening)
    is_valid = free & truth.truly_antipodal(candidates, gripper.max_opening)
    good = np.flatnonzero(is_valid[: len(valid)])
    bad = len(valid) + np.flatnonzero(
        free[len(valid) :] & ~is_valid[len(valid) :] & np.isfinite(closed.width[len(valid) :])
    )
    chosen = np.concatenate([good, bad[: count // 2]]).astype(int)
    return candidates[chosen], is_valid[chosen], closed.cosine[chosen]


def try_object(name: str, obj: RigidObject, count: int, seed: int) -> list[Record]:
    """Tries grasps of one object; one record each."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    gripper = ParallelGripper()
    X_OG, valid, cosine = sample_grasps(TrueGrasps(obj.mesh), gripper, count, rng)
    trials = hold_trials(obj, X_OG, gripper, friction=FRICTION)
    return [
        {"object": name, "valid": bool(v), "cosine": float(c), "held": t.held, "why": t.why}
        for v, c, t in zip(valid, cosine, trials, strict=True)
    ]


def summary_rows(records: list[Record]) -> list[Row]:
    """Shares held of valid and other grasps, and how often label and simulation agree."""
    rows = []
    for preset, wanted in (("valid", True), ("not antipodal", False)):
        group = [r["held"] for r in records if r["valid"] == wanted]
        if group:
            share = proportion(sum(group), len(group))
            rows.append(Row.of("labels.held_percent", preset, share, "%", 100.0))
    agree = [r["held"] == r["valid"] for r in records]
    if agree:
        share = proportion(sum(agree), len(agree))
        rows.append(Row.of("labels.agreement_percent", "all", share, "%", 100.0))
    return rows


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    shapes, grasps = (1, 4) if args.quick else (args.shapes, args.grasps)
    jobs: dict[str, tuple[str, int | str]] = {}
    if args.objects is None:
        for family in FAMILIES:
            for i in range(shapes):
                jobs[f"{family}_{i}"] = (family, FIRST_SEED + 1000 * args.seed + i)
    else:
        jobs = {name: ("", path) for name, path in select_objects(args.objects).items()}
    key = {"git": git_revision(), "versions": versions(), "grasps": grasps, "seed": args.seed}
    folder = args.out / "objects"
    missing = [name for name in jobs if finished_records(folder / f"{name}.json", key) is None]
    tried = joblib.Parallel(n_jobs=args.jobs, return_as="generator_unordered")(
        joblib.delayed(_try_to_file)(name, *jobs[name], folder, key) for name in missing
    )
    done = len(jobs) - len(missing)
    with tqdm(total=len(jobs), initial=done, desc="grasp labels", unit="object") as bar:
        for _ in tried:
            bar.update()
    records = [r for name in jobs for r in finished_records(folder / f"{name}.json", key) or []]
    with (args.out / "grasps.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, ["object", "valid", "cosine", "held", "why"])
        writer.writeheader()
        writer.writerows(records)
    rows = summary_rows(records)
    options = ("out", "seed", "jobs", "objects", "shapes", "grasps")
    words = [
        w
        for o in options
        if getattr(args, o) is not None
        for w in (f"--{o}", str(getattr(args, o)))
    ]
    command = shlex.join(
        ["feasigrasp", "evaluate", "grasp-labels", *words, *["--quick"] * args.quick]
    )
    write_summary(args.out / "summary.json", command, key["git"], args.seed, rows, quick=args.quick)
    print(format_rows(rows))
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
    X = np.eye(4)
    X[:3, 0], X[:3, 1], X[:3, 2], X[:3, 3] = x, np.cross(z, x), z, origin
    return X


def _unit(vectors: Array) -> Array:
    unit: Array = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return unit


def _try_to_file(
    name: str, family: str, seed_or_path: int | str, folder: Path, key: dict[str, Any]
) -> None:
    obj = make_shape(family, int(seed_or_path)) if family else load_object(str(seed_or_path))
    records = try_object(name, obj, key["grasps"], key["seed"])
    write_json({"key": key, "records": records}, folder / f"{name}.json")
