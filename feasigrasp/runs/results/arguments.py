"""Reads options of commands, and prints what a mesh's loader notes."""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

from feasigrasp.models.grasps.samplers import SamplerName, sampler_names
from feasigrasp.models.objects.rigid_object import RigidObject


def positive(text: str) -> int:
    """Reads a whole number of at least 1 from the command line."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is less than 1")
    return number


def factor(text: str) -> float:
    """Reads a number above zero from the command line."""
    number = float(text)
    if not 0.0 < number < float("inf"):
        raise argparse.ArgumentTypeError(f"{text}: give a finite number above zero")
    return number


def share(text: str) -> float:
    """Reads a share from the command line: ``20%``, or 0.2."""
    number = 0.01 * float(text[:-1]) if text.endswith("%") else float(text)
    if not 0.0 < number <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not from 0 to 100%; give e.g. 20% or 0.2")
    return number


def add_box(parser: argparse.ArgumentParser, use: str) -> None:
    """Adds the option for a box in an image, and what it is used for."""
    sides = ("LEFT", "TOP", "RIGHT", "BOTTOM")
    parser.add_argument("--box", type=int, nargs=4, metavar=sides, help=use)


def add_sampler(parser: argparse.ArgumentParser) -> None:
    """Adds the option for the sampler of the grasps."""
    names, usual = sampler_names(), SamplerName.NETWORK
    parser.add_argument("--sampler", choices=names, default=usual, help="Sampler of the grasps.")


def output(*ends: str) -> Callable[[str], Path]:
    """Reads the name of a file to write: of any suffix, or of one of these ("" is none)."""

    def file(text: str) -> Path:
        named = Path(text)
        if not named.name:
            raise argparse.ArgumentTypeError(f"{text!r} names no file; give one")
        if ends and named.suffix.lower() not in ends:
            raise argparse.ArgumentTypeError(f"{text}: end it in {' or '.join(filter(None, ends))}")
        return named

    return file


def print_notes(obj: RigidObject) -> None:
    """Prints repairs and warnings of the mesh loader."""
    for note in obj.notes:
        print(f"note: {obj.name}: {note}", file=sys.stderr)
