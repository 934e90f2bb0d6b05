"""Whether this code gives the runs of older revisions: reference runs of all, bit for bit.

``python tools/same_runs.py REVISION ...`` runs each line of ``tools/same_runs.yaml`` in a checkout
of each revision and in one of HEAD, and compares all logged positions, commands and poses. Runs are
by the camera alone, with the object's pose given, or in the paper's modes. Of each kind of which
all are equal, it notes HEAD in the file: figures of that kind and revision count as figures of
HEAD, and so do those of revisions that gave the same runs before.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from itertools import repeat
from pathlib import Path

import numpy as np
import yaml

from tools.stored import ROOT

RUNS = Path(__file__).with_name("same_runs.yaml")


def stands_for(revision: str, kind: str) -> str:
    """The latest revision that gave the reference runs of a kind of this one, or itself."""
    same = yaml.safe_load(RUNS.read_text())["same"]
    return str(same.get(kind, {}).get(revision, revision))


def _short(revision: str) -> str:
    """A revision as stored rows name it."""
    command = ["git", "rev-parse", "--short=12", revision]
    output = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return output.strip()


def differences(ours: Path, theirs: Path) -> list[str]:
    """Names of the logged quantities that two logs do not have alike."""
    with np.load(ours) as one, np.load(theirs) as other:
        names = sorted({*one.files} | {*other.files})
        return [name for name in names if not _equal(one.get(name), other.get(name))]


def _equal(one: np.ndarray | None, other: np.ndarray | None) -> bool:
    if one is None or other is None:
        return False
    return np.array_equal(one, other, equal_nan=one.dtype.kind == "f")


@contextmanager
def _checkout(revision: str) -> Iterator[Path]:
    """A checkout of a revision, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--detach", "--force", folder, revision], check=True)
        try:
            for cache in ROOT.glob("feasigrasp*/**/__pycache__"):  # kernels that did not change
                shutil.copytree(cache, Path(folder) / cache.relative_to(ROOT))
            yield Path(folder)
        finally:
            subprocess.run([*git, "remove", "--force", folder], check=True)


def _log(checkout: Path, words: str) -> Path:
    """The log of one run in a checkout."""
    file = checkout / "run.npz"
    file.unlink(missing_ok=True)
    command = [sys.executable, "-m", "feasigrasp.cli", "run", *shlex.split(words)]
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    subprocess.run(
        [*command, "--log", str(file)],
        cwd=checkout,
        env=environment,
        stdout=subprocess.DEVNULL,
        check=False,
    )
    return file


def main() -> int:
    """Runs the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    content, differ = yaml.safe_load(RUNS.read_text()), False
    parser.add_argument("revisions", nargs="+", metavar="REVISION", help="an older revision")
    parser.add_argument("--kind", choices=content["runs"], help="the only kind of runs")
    args = parser.parse_args()
    revisions, head = [_short(each) for each in args.revisions], _short("HEAD")
    with ExitStack() as stack:
        checkouts = [stack.enter_context(_checkout(each)) for each in (head, *revisions)]
        pool = stack.enter_context(ThreadPoolExecutor(os.cpu_count()))
        for kind in [args.kind] if args.kind else content["runs"]:
            equal = dict.fromkeys(revisions, True)
            for words in content["runs"][kind]:
                now, *then = pool.map(_log, checkouts, repeat(words))
                for revision, log in zip(revisions, then, strict=True):
                    differs = differences(now, log)
                    print(f"{revision}, {words}: {', '.join(differs) or 'the same'}", flush=True)
                    equal[revision] &= not differs
            noted = content["same"][kind]
            alike = {noted.get(each, each) for each in revisions if equal[each]}
            alike |= {each for each in revisions if equal[each]}
            noted |= {each: head for each in {*noted, *revisions} if noted.get(each, each) in alike}
            differ |= not all(equal.values())
    lines = RUNS.read_text().partition("same:")[0]
    RUNS.write_text(lines + yaml.safe_dump({"same": content["same"]}))
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
