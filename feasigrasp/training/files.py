"""The files of trainings and of their data, whole or not there at all; the processor's setting.

``checkpoint.pt`` holds the state of a run, ``curve.csv`` one line for every evaluation, and the
examples are in shards, ``npz`` files that are made once.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import torch
from tqdm import tqdm

from feasigrasp.errors import FeasigraspError


class TrainingError(FeasigraspError, ValueError):
    """A training run that cannot start or go on with these arguments."""


@contextmanager
def without_denormals() -> Iterator[None]:
    """Numbers too small for full precision count as zero: with them a step takes far longer."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def write_checkpoint(folder: Path, identity: Mapping[str, Any], **state: Any) -> None:
    """Writes what a run resumes from, whole or not at all.

    Args:
        folder: Folder of the run.
        identity: What no resumed run may change, e.g. its seed.
        **state: Tensors, numbers and containers of them, e.g. state dicts of modules.
    """
    partial = folder / "checkpoint.pt.part"
    torch.save({"identity": identity, **state}, partial)
    partial.replace(folder / "checkpoint.pt")


def read_checkpoint(
    folder: Path, identity: Mapping[str, Any], device: torch.device | str
) -> dict[str, Any] | None:
    """What `write_checkpoint` wrote; a folder without is made ready for a new run.

    Args:
        folder: Folder of the run, made if it is not there.
        identity: That of the run to resume.
        device: Where the tensors shall be.

    Returns:
        The state; None for a new run, whose curve then has no lines of an earlier one.

    Raises:
        TrainingError: The folder holds a run with another identity.
    """
    folder.mkdir(parents=True, exist_ok=True)
    filename = folder / "checkpoint.pt"
    if not filename.exists():
        (folder / "curve.csv").unlink(missing_ok=True)
        return None
    state: dict[str, Any] = torch.load(filename, map_location=device, weights_only=True)
    written = state.pop("identity")
    if written != identity:
        raise TrainingError(
            f"{folder} holds a run with {written}, this one has {identity}; choose another --out, "
            "or the same arguments to resume"
        )
    return state


def append_curve(folder: Path, columns: Sequence[str], row: Mapping[str, float]) -> None:
    """Appends a line to the curve, below a header if it is the first; NaN where ``row`` has none.

    Args:
        folder: Folder of the run.
        columns: Names of the columns, in order.
        row: Figures by column.
    """
    filename = folder / "curve.csv"
    new = not filename.exists()
    with filename.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(columns)
        writer.writerow([f"{row.get(column, math.nan):.6g}" for column in columns])


def write_arrays(filename: Path, arrays: Mapping[str, Any]) -> None:
    """Writes an ``npz`` file: one of its name is a whole one."""
    filename.parent.mkdir(parents=True, exist_ok=True)
    partial = filename.with_suffix(".part")
    with partial.open("wb") as file:
        np.savez_compressed(file, **arrays)
    partial.replace(filename)


def make_shards(
    files: Sequence[Path], make: Callable[[Path, int], bool], *, jobs: int, desc: str
) -> int:
    """Makes the shards that are not there yet, with a progress bar.

    Args:
        files: Where they are, in the order of their numbers.
        make: Makes one, from its file and number; whether it did.
        jobs: Processes at a time.
        desc: What the bar is called.

    Returns:
        How many are there in the end.
    """
    missing = [number for number, file in enumerate(files) if not file.exists()]
    work = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
        joblib.delayed(make)(files[number], number) for number in missing
    )
    there = len(files) - len(missing)
    with tqdm(total=len(files), initial=there, desc=desc, unit="shard") as bar:
        for made in work:
            there += made
            bar.update(made)
    return there
