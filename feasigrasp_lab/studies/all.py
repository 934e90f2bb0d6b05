"""``feasigrasp evaluate all``: run every measurement of the result tables, at one revision.

``feasigrasp_lab/protocols/all.yaml`` lists them. Each writes into ``DIR/<name>``, and is not run
again once its ``summary.json`` is there; repeated, the command goes on where it was.
"""

import argparse
import shlex
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import joblib
import yaml

from feasigrasp.errors import FeasigraspError, InputError
from feasigrasp.inputs import read_json
from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab import protocols
from feasigrasp_lab.results.arguments import names
from feasigrasp_lab.results.workers import Shard

_TABLES = Path(protocols.__file__).with_name("all.yaml")


class RevisionError(FeasigraspError, RuntimeError):
    """Results of two revisions in one folder."""


@dataclass(frozen=True)
class Measurement:
    """One command of the result tables.

    Attributes:
        command: What follows ``feasigrasp``, without ``--out`` and ``--jobs``.
        minutes: Its estimated processor time on one core [min].
        quick: Whether it is part of the sample that ``--quick`` runs.
    """

    command: str
    minutes: float
    quick: bool = False


def measurements() -> dict[str, Measurement]:
    """All of them, by the name of their stored rows."""
    table = yaml.safe_load(_TABLES.read_text())
    return {name: Measurement(**entry) for name, entry in table.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    cpus = joblib.cpu_count()
    parser.add_argument(
        "--out", type=Path, default=Path("out/results"), help="Folder of the results."
    )
    parser.add_argument("--jobs", type=positive, default=cpus, help="Number of parallel processes.")
    parser.add_argument("--quick", action="store_true", help="Run a sample, in about 20 minutes.")
    parser.add_argument(
        "--only", type=names, help="Measurements, separated by commas. Default: all."
    )
    parser.add_argument(
        "--data",
        type=Path,
        default=Path("../shared/data"),
        help="Folder with data that is not part of the project, e.g. YCB meshes in ycb/.",
    )
    parser.add_argument(
        "--shard",
        type=Shard.read,
        metavar="I/N",
        help="Run every N-th measurement only, from the I-th on; the results are in "
        "OUT/shard-I-of-N.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    chosen = _chosen(args)
    _keep_to_one_revision(args.out)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # ends the running one as well
    missing = {n: m for n, m in chosen.items() if not (args.out / n / "summary.json").exists()}
    print(f"{len(chosen) - len(missing)} of {len(chosen)} are finished already in {args.out}")
    status, estimated, measured = 0, 0.0, 0.0
    for number, (name, measurement) in enumerate(missing.items(), start=1):
        left = sum(m.minutes for m in list(missing.values())[number - 1 :])
        pace = measured / estimated if estimated else 1.0 / args.jobs
        print(f"\n{name}, {number} of {len(missing)}; {pace * left:.0f} min left", flush=True)
        start = time.monotonic()
        failed = subprocess.run(command_of(name, measurement, args)).returncode
        status = max(status, failed)
        estimated += measurement.minutes
        measured += (time.monotonic() - start) / 60.0
        if failed < 0 or failed == 130:
            break
    return status


def command_of(name: str, measurement: Measurement, args: argparse.Namespace) -> list[str]:
    """The words of the command line of a measurement."""
    words = shlex.split(measurement.command.replace("DATA", str(args.data)))
    options = ["--out", str(args.out / name), "--jobs", str(args.jobs)]
    return [sys.executable, "-m", "feasigrasp.cli", *words, *options, *["--quick"] * args.quick]


def _chosen(args: argparse.Namespace) -> dict[str, Measurement]:
    """The measurements that the arguments ask for.

    Raises:
        InputError: ``--only`` has another name.
    """
    every = measurements()
    unknown = sorted({*(args.only or ())} - {*every})
    if unknown:
        raise InputError(
            f"--only: no measurement {', '.join(unknown)}; choose of {', '.join(every)}"
        )
    found = {n: m for n, m in every.items() if (m.quick or not args.quick)}
    if args.only:
        found = {name: every[name] for name in args.only}
    shard = args.shard or Shard(1, 1)
    return dict(list(found.items())[shard.index - 1 :: shard.count])


def _keep_to_one_revision(out: Path) -> None:
    """Notes the revision of the code in the folder, or compares it with the one noted there.

    Raises:
        RevisionError: The folder has results of another revision, or the code has changes that are
            in no revision.
    """
    revision, file = git_revision(), out / "revision.json"
    if revision is None or revision.endswith("-dirty"):
        raise RevisionError(f"the code is of revision {revision}; commit its changes, then measure")
    if not file.exists():
        write_json({"git": revision}, file)
    noted = read_json(file)["git"]
    if noted != revision:
        raise RevisionError(
            f"{out} has results of revision {noted}, and the code is of {revision}; check {noted} "
            "out, or give another --out"
        )
