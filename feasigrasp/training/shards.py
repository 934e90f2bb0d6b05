"""The data of trainings on disk, in ``npz`` files that are whole or not there at all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from tqdm import tqdm


def write_arrays(filename: Path, arrays: Mapping[str, Any], *, compressed: bool = True) -> None:
    """Writes an ``npz`` file: one of its name is a whole one."""
    filename.parent.mkdir(parents=True, exist_ok=True)
    partial = filename.with_suffix(".part")
    with partial.open("wb") as file:
        (np.savez_compressed if compressed else np.savez)(file, **arrays)
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
