"""Reached poses on disk, in parts: what `feasigrasp fit reachability` can be interrupted in."""

from __future__ import annotations

import resource
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from joblib.externals.loky import get_reusable_executor

from feasigrasp.training.reachability.reachable_poses import (
    ReachedPoses,
    SerialArm,
    join,
    sample_reachable_poses,
)
from feasigrasp.training.shards import make_shards, write_arrays

#: Configurations per part; each part has its own stream of random numbers.
PART = 250_000


def draw_all(
    arm: SerialArm, n: int, seed: int, folder: Path, jobs: int, **options: Any
) -> ReachedPoses:
    """Draws what a folder does not have yet; the result does not depend on what it has.

    Args:
        arm: The arm. If it cannot be sent to another process, take ``jobs=1``.
        n: Number of configurations.
        seed: Seed of all of them.
        folder: Where the parts are kept.
        jobs: Processes at a time.
        **options: See `sample_reachable_poses`.
    """
    sizes = [min(PART, n - start) for start in range(0, n, PART)]
    files = [folder / f"part-{i:04d}.npz" for i in range(len(sizes))]
    draw = partial(_draw_part, arm=arm, sizes=sizes, seed=seed, options=options)
    make_shards(files, draw, jobs=jobs, desc="sampling")
    if jobs > 1:
        get_reusable_executor().shutdown(wait=True)  # what comes next needs the memory
    return join([_load(file) for file in files])


def peak_memory_gb() -> float:
    """The most memory that this process, and any one of its finished children, have held [GB]."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_maxrss for u in usage) / 1e6


def _draw_part(
    file: Path, i: int, *, arm: SerialArm, sizes: list[int], seed: int, options: dict[str, Any]
) -> bool:
    rng = np.random.default_rng([seed, i])
    poses = sample_reachable_poses(arm, sizes[i], rng, **options)
    write_arrays(file, poses._asdict(), compressed=False)
    return True


def _load(file: Path) -> ReachedPoses:
    with np.load(file) as stored:
        quaternions, positions = stored["quaternions"], stored["positions"]
        counts = (int(stored[name]) for name in ReachedPoses._fields[2:])
        return ReachedPoses(quaternions, positions, *counts)
