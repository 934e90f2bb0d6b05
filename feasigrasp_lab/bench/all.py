"""``feasigrasp bench all``: run all benchmarks, one after the other."""

import argparse
from importlib import import_module

from feasigrasp_lab.results.arguments import add_common_arguments

BENCHMARKS = ("shape", "kinematics", "reachability", "control", "sampler")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench", objects="mustard_bottle")


def main(args: argparse.Namespace) -> int:
    """Runs the command; ``DIR/shape/summary.json`` and so on are those of the single benchmarks."""
    status = 0
    for name in BENCHMARKS:
        benchmark = import_module(f"feasigrasp_lab.bench.{name}")
        parser = argparse.ArgumentParser()
        benchmark.add_arguments(parser)
        options = ["--out", str(args.out / name), "--seed", str(args.seed)]
        options += ["--objects", args.objects, *["--quick"] * args.quick]
        print(f"\nbench {name}", flush=True)
        status |= benchmark.main(parser.parse_args(options))
    return status
