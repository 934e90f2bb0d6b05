"""``feasigrasp train sampler-data``: make the training data of the grasp network.

A stream of objects, each looked at once or a few times, becomes shards of labelled examples
(``shape_00042.npz``; docs/developing.md has their format). The stream is endless and given by
its seed alone: more objects later continue it, and a command that was interrupted goes on after its
last shard. One object in eight is of a family that is held out.
"""

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.results.finished import make_shards, write_arrays
from feasigrasp_lab.results.workers import made_with
from feasigrasp_lab.training.data.grasp_examples import object_examples, stacked
from feasigrasp_lab.training.data.household_shapes import HELD_OUT, make_shape, shape_of

#: Objects of a shard. Source: numerical.
SHARD = 8


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/sampler_data")
    parser.add_argument(
        "--objects", type=positive, default=1600, help="Number of generated objects."
    )
    parser.add_argument("--inputs", type=positive, default=2, help="Number of examples per object.")


def _write_shard(filename: Path, number: int, *, inputs: int, seed: int) -> None:
    """Makes one shard, whose number says what objects are in it."""
    examples = []
    for index in range(number * SHARD, (number + 1) * SHARD):
        rng = np.random.default_rng([seed, index])
        family, number_of = shape_of(index, seed)
        examples += object_examples(make_shape(family, number_of), family, number_of, inputs, rng)
    if examples:
        write_arrays(filename, stacked(examples))


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    settings = {"kind": "shape", "seed": args.seed, "inputs": args.inputs}
    write_json(settings | {"held_out": list(HELD_OUT)} | made_with(), args.out / "shape.json")
    files = [args.out / f"shape_{n:05d}.npz" for n in range(-(-args.objects // SHARD))]
    make = partial(_write_shard, inputs=args.inputs, seed=args.seed)
    there = make_shards(files, make, jobs=args.jobs, desc="sampler data")
    print(f"{len(there)} of {len(files)} shards of {SHARD} objects are in {args.out}")
    return 0
