"""Common arguments of commands, and their serialization."""

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import joblib

from feasigrasp.errors import MeshError
from feasigrasp.models.objects.rigid_object import builtin_objects, find_objects
from feasigrasp.runs.results.arguments import positive


class FormerOption(argparse.Action):
    """A former name of an option: works for one release, with a warning that names the new one."""

    def __init__(self, option_strings: Sequence[str], dest: str, **options: Any) -> None:
        """Hides the option from the help; its default is that of the new one."""
        options |= {"default": argparse.SUPPRESS, "help": argparse.SUPPRESS}
        super().__init__(option_strings, dest, **options)

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        """Stores the value under the new name, with a warning."""
        new = "--" + self.dest.replace("_", "-")
        print(f"{option_string} is now {new}; the next release does not read it", file=sys.stderr)
        setattr(namespace, self.dest, values)


def add_run_arguments(parser: argparse.ArgumentParser, *, out: str, jobs: bool = True) -> None:
    """Adds ``--out --seed --jobs``, which a command that trains or fits takes as well."""
    parser.add_argument("--out", type=Path, default=Path(out), help="Folder of the results.")
    parser.add_argument("--seed", type=int, default=0, help="Seed of the first repeat.")
    if jobs:
        cpus = joblib.cpu_count()
        parser.add_argument(
            "--jobs", type=positive, default=cpus, help="Number of parallel processes."
        )


def add_common_arguments(parser: argparse.ArgumentParser, *, out: str, objects: str | None) -> None:
    """Adds ``--out --seed --jobs --objects --quick``.

    Args:
        parser: Parser of one command.
        out: Default folder of the results.
        objects: Default objects, see `select_objects`; None if they depend on other arguments.
    """
    add_run_arguments(parser, out=out)
    parser.add_argument(
        "--objects",
        default=objects,
        help="Objects: 'builtin' for all built-in ones, folders of meshes, names and mesh files, "
        f"separated by commas. Default: {objects or 'see the page of the command in docs'}.",
    )
    parser.add_argument("--quick", action="store_true", help="Run a sample, in at most 3 minutes.")


def add_controllers_argument(parser: argparse.ArgumentParser) -> None:
    """Adds ``--controllers``."""
    parser.add_argument(
        "--controllers",
        type=names,
        default=["task", "joint"],
        help="Controllers, separated by commas.",
    )


def names(text: str) -> list[str]:
    """Reads names that are separated by commas from the command line, each of them once."""
    found = list(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    if not found:
        raise argparse.ArgumentTypeError("no name given")
    return found


def minutes(text: str) -> float:
    """Reads a length of time from the command line."""
    length = float(text)
    if not length > 0.0:
        raise argparse.ArgumentTypeError(f"{text} minutes are no time")
    return length


def command_line(args: argparse.Namespace, command: str) -> str:
    """The line that gives a command these arguments, those with a default included.

    Args:
        args: Arguments of the command; an option is spelled as its entry, with ``-`` for ``_``.
        command: Its name, e.g. ``evaluate shape``.
    """
    words = ["feasigrasp", *command.split()]
    for name, value in vars(args).items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        elif value is not None and value is not False:
            words += [option, ",".join(map(str, value)) if isinstance(value, list) else str(value)]
    return shlex.join(words)


def select_objects(selection: str) -> dict[str, str]:
    """The objects that ``--objects`` asks for.

    Args:
        selection: ``builtin``, folders of meshes, built-in names and mesh files, separated by
            commas.

    Returns:
        By name, what `feasigrasp.models.objects.rigid_object.load_object` loads; not loaded yet.

    Raises:
        MeshError: A folder without meshes, nothing named at all, or two files of one name.
    """
    try:
        parts = names(selection)
    except argparse.ArgumentTypeError as error:
        raise MeshError(f"--objects {selection!r}: {error}; name an object or a file") from error
    objects: dict[str, str] = {}
    for part in parts:
        found = {Path(part).stem: part}
        if part == "builtin":
            found = {name: name for name in builtin_objects()}
        elif Path(part).is_dir():
            found = {name: str(path) for name, path in find_objects(part).items()}
        for name, file in found.items():
            other = objects.setdefault(name, file)
            if other != file:
                raise MeshError(
                    f"--objects: {other} and {file} have the same name, which results go by; "
                    "rename one"
                )
    return objects
