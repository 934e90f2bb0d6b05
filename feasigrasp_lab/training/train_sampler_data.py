"""``feasigrasp train sampler-data``: make the training data of the grasp network.

A stream of objects, each looked at once or a few times, becomes shards of labelled examples
(``shape_00042.npz``; docs/developing.md has their format). The stream is endless and given by
its seed alone: more objects later continue it, and a command that was interrupted goes on after its
last shard. One object in eight is of a family that is held out. By default all shapes are our own;
``--meshes`` adds those of others to the same folder.
"""

from __future__ import annotations

import argparse
import time
from functools import partial
from pathlib import Path

import numpy as np

from feasigrasp.errors import MeshError
from feasigrasp.runs.results.arguments import add_run_arguments, positive
from feasigrasp.runs.results.rows import write_json
from feasigrasp_lab.results.finished import make_shards, write_arrays
from feasigrasp_lab.results.workers import made_with
from feasigrasp_lab.training.data.grasp_examples import object_examples, stacked
from feasigrasp_lab.training.data.household_shapes import HELD_OUT
from feasigrasp_lab.training.data.object_streams import ObjectStream

#: Objects of a shard.
SHARD = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/sampler_data")
    parser.add_argument(
        "--objects", type=positive, default=1600, help="Number of generated objects."
    )
    parser.add_argument("--inputs", type=positive, default=2, help="Number of examples per object.")
    parser.add_argument(
        "--minutes",
        type=float,
        default=float("inf"),
        help="Time after which no shard starts, in minutes.",
    )
    parser.add_argument(
        "--meshes", type=Path, help="Take objects from a folder or an npz file of meshes."
    )
    parser.add_argument("--sheet", type=Path, help="Draw some shapes into this PNG and stop.")


def _write_shard(
    filename: Path, number: int, *, inputs: int, stream: ObjectStream, deadline: float
) -> bool:
    """Makes one shard, whose number says what objects are in it; whether there was time for it."""
    if time.time() > deadline:
        return False
    examples = []
    for index in range(number * SHARD, min((number + 1) * SHARD, len(stream))):
        rng = np.random.default_rng([stream.seed, index])
        try:
            streamed = stream[index]
        except MeshError as error:
            print(f"left out: {error}")
            continue
        examples += object_examples(streamed.obj, streamed.family, streamed.seed, inputs, rng)
    if examples:
        write_arrays(filename, stacked(examples))
    return True


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.sheet is not None:
        from feasigrasp_lab.training.data.shape_sheet import draw_sheet

        draw_sheet(args.sheet, args.seed)
        print(f"wrote {args.sheet}")
        return 0
    stream = ObjectStream("mesh" if args.meshes else "shape", args.meshes, args.seed)
    settings = {"kind": stream.kind, "seed": args.seed, "inputs": args.inputs}
    about = settings | {"held_out": list(HELD_OUT)} | made_with()
    write_json(about, args.out / f"{stream.kind}.json")
    numbers = range(-(-min(args.objects, len(stream)) // SHARD))
    files = [args.out / f"{stream.kind}_{number:05d}.npz" for number in numbers]
    deadline = time.time() + 60.0 * args.minutes
    make = partial(_write_shard, inputs=args.inputs, stream=stream, deadline=deadline)
    there = make_shards(files, make, jobs=args.jobs, desc="sampler data")
    print(f"{there} of {len(files)} shards of {SHARD} objects are in {args.out}")
    return 0
