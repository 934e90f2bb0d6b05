"""``feasigrasp objects``: list the built-in objects with their sizes and masses."""

import argparse

from feasigrasp.models.objects.rigid_object import builtin_objects, load_object


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command: none."""


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    names = builtin_objects()
    width = max(map(len, names))
    print(f"{'object':{width}s}  {'size [cm]':>18s}  {'mass [g]':>8s}")
    for name in names:
        obj = load_object(name)
        size = " x ".join(f"{100.0 * side:4.1f}" for side in obj.extents)
        print(f"{name:{width}s}  {size:>18s}  {1000.0 * obj.mass:8.0f}")
    return 0
