"""``feasigrasp train sampler-data``: makes the training data of the grasp network.

A stream of objects, each looked at once or a few times, becomes shards of labelled examples
(``shape_00042.npz``; docs/sampler_data.md says what is in them). The stream is endless and told by
its seed alone: more objects later continue it, and a command that was interrupted goes on after its
last shard. One object in eight is of a family that is held out. By default all shapes are our own;
``--meshes`` and ``--acronym`` add those of others to the same folder.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm

from feasigrasp.errors import MeshError
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.results.arguments import positive
from feasigrasp.results.provenance import git_revision, versions
from feasigrasp.results.rows import write_json
from feasigrasp.training.data.grasp_examples import object_examples, stacked
from feasigrasp.training.data.household_shapes import HELD_OUT
from feasigrasp.training.data.object_streams import ObjectStream

#: Objects of a shard.
SHARD = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    parser.add_argument(
        "--out", type=Path, default=Path("out/sampler_data"), help="folder of the shards"
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the stream")
    parser.add_argument("--objects", type=positive, default=1600, help="objects of the stream")
    parser.add_argument("--inputs", type=positive, default=2, help="examples per object")
    parser.add_argument(
        "--jobs", type=positive, default=joblib.cpu_count(), help="processes at a time"
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="start no shard after this time"
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--meshes", type=Path, help="objects from a folder of meshes or an npz file of them"
    )
    source.add_argument("--acronym", type=Path, help="objects and grasps from a folder of ACRONYM")
    parser.add_argument("--sheet", type=Path, help="only draw some shapes into this PNG")


def write_shard(
    filename: Path, number: int, inputs: int, stream: ObjectStream, deadline: float
) -> int:
    """Makes one shard.

    Args:
        filename: Where.
        number: Of the shard, which says what objects are in it.
        inputs: Examples per object.
        stream: The objects.
        deadline: Time after which it is not begun, as of `time.time`.

    Returns:
        How many examples are in it; -1 if it was too late.
    """
    if time.time() > deadline:
        return -1
    examples = []
    for index in range(number * SHARD, min((number + 1) * SHARD, len(stream))):
        rng = np.random.default_rng([stream.seed, index])
        try:
            streamed = stream[index]
        except MeshError as error:
            print(f"left out: {error}")
            continue
        examples += object_examples(
            streamed.obj,
            streamed.family,
            streamed.seed,
            inputs,
            ParallelGripper(),
            rng,
            streamed.label,
        )
    if examples:
        save_shard(filename, stacked(examples))
    return len(examples)


def save_shard(filename: Path, arrays: dict[str, Any]) -> None:
    """Writes a shard; a file of its name is a whole one."""
    filename.parent.mkdir(parents=True, exist_ok=True)
    partial = filename.with_suffix(".part")
    with partial.open("wb") as file:
        np.savez_compressed(file, **arrays)
    partial.replace(filename)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.sheet is not None:
        from feasigrasp.training.data.shape_sheet import draw_sheet

        draw_sheet(args.sheet, args.seed)
        print(f"wrote {args.sheet}")
        return 0
    stream = ObjectStream("shape", None, args.seed)
    if args.meshes is not None:
        stream = ObjectStream("mesh", args.meshes, args.seed)
    elif args.acronym is not None:
        stream = ObjectStream("acronym", args.acronym, args.seed)
    objects = min(args.objects, len(stream))
    settings = {"kind": stream.kind, "seed": args.seed, "inputs": args.inputs}
    about = args.out / f"{stream.kind}.json"
    write_json(
        {**settings, "held_out": list(HELD_OUT), "git": git_revision(), "versions": versions()},
        about,
    )
    numbers = range(-(-objects // SHARD))
    files = {number: args.out / f"{stream.kind}_{number:05d}.npz" for number in numbers}
    missing = [number for number, file in files.items() if not file.exists()]
    deadline = time.time() + 60.0 * args.minutes
    made = joblib.Parallel(n_jobs=args.jobs, return_as="generator_unordered")(
        joblib.delayed(write_shard)(files[number], number, args.inputs, stream, deadline)
        for number in missing
    )
    done = len(files) - len(missing)
    with tqdm(total=len(files), initial=done, desc="sampler data", unit="shard") as bar:
        for count in made:
            if count >= 0:
                done += 1
                bar.update()
    print(f"{done} of {len(files)} shards of {SHARD} objects are in {args.out}")
    return 0
