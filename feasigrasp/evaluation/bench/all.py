"""``feasigrasp bench all``: every benchmark, one after the other, each in a folder of its own."""

from __future__ import annotations

import argparse

from feasigrasp.evaluation.bench import control as bench_control
from feasigrasp.evaluation.bench import kinematics as bench_kinematics
from feasigrasp.evaluation.bench import reachability as bench_reachability
from feasigrasp.evaluation.bench import safety as bench_safety
from feasigrasp.evaluation.bench import sampler as bench_sampler
from feasigrasp.evaluation.bench import shape as bench_shape
from feasigrasp.results.arguments import add_common_arguments

BENCHMARKS = {
    "shape": bench_shape,
    "kinematics": bench_kinematics,
    "reachability": bench_reachability,
    "control": bench_control,
    "safety": bench_safety,
    "sampler": bench_sampler,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench", objects="mustard_bottle")


def main(args: argparse.Namespace) -> int:
    """Runs the command; ``DIR/shape/summary.json`` and so on are those of the single benchmarks."""
    status = 0
    for name, benchmark in BENCHMARKS.items():
        parser = argparse.ArgumentParser()
        benchmark.add_arguments(parser)
        options = ["--out", str(args.out / name), "--seed", str(args.seed)]
        options += ["--objects", args.objects, *["--quick"] * args.quick]
        print(f"\nbench {name}", flush=True)
        status |= benchmark.main(parser.parse_args(options))
    return status
