"""Reached poses on disk, in parts: what `feasigrasp fit reachability` can be interrupted in."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import joblib
import numpy as np
from joblib.externals.loky import get_reusable_executor
from tqdm import tqdm

from feasigrasp.training.reachability.reachable_poses import (
    ReachedPoses,
    SerialArm,
    join,
    sample_reachable_poses,
)

#: Configurations per part; each part has its own stream of random numbers.
PART = 250_000


@dataclass(frozen=True, eq=False)
class SamplingPlan:
    """What to draw.

    Attributes:
        samples: Number of configurations.
        seed: Seed of all of them.
        X_FT: Frame to fit in the end frame of the arm, shape (4, 4) [m].
        floor: Lowest z of the fitted frame [m].
        thin: See `sample_reachable_poses`.
    """

    samples: int
    seed: int
    X_FT: np.ndarray
    floor: float
    thin: float | None

    def part_sizes(self) -> list[int]:
        """Configurations of each part."""
        full, rest = divmod(self.samples, PART)
        return [PART] * full + [rest] * (rest > 0)


def draw_all(arm: SerialArm, plan: SamplingPlan, folder: Path, jobs: int) -> ReachedPoses:
    """Draws what a folder does not have yet; the result depends on the plan alone.

    Args:
        arm: The arm. If it cannot be sent to another process, take ``jobs=1``.
        plan: What to draw.
        folder: Where the parts are kept.
        jobs: Processes at a time.
    """
    folder.mkdir(parents=True, exist_ok=True)
    sizes = plan.part_sizes()
    files = [folder / f"part-{i:04d}.npz" for i in range(len(sizes))]
    missing = [i for i, file in enumerate(files) if not _is_whole(file)]
    with tqdm(
        total=len(sizes), initial=len(sizes) - len(missing), unit="part", desc="sampling"
    ) as bar:
        for _ in _run(arm, plan, files, sizes, missing, jobs):
            bar.update()
    return join([_load(file) for file in files])


def peak_memory_gb() -> float:
    """The most memory that this process, and any one of its finished children, have held [GB]."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_maxrss for u in usage) / 1e6


def _run(
    arm: SerialArm,
    plan: SamplingPlan,
    files: list[Path],
    sizes: list[int],
    missing: list[int],
    jobs: int,
) -> Iterator[None]:
    if jobs == 1 or len(missing) < 2:
        for i in missing:
            _draw_part(arm, plan, i, sizes[i], files[i])
            yield
        return
    parallel = joblib.Parallel(jobs, return_as="generator_unordered")
    yield from parallel(
        joblib.delayed(_draw_part)(arm, plan, i, sizes[i], files[i]) for i in missing
    )
    get_reusable_executor().shutdown(wait=True)  # what comes next needs the memory


def _draw_part(arm: SerialArm, plan: SamplingPlan, i: int, n: int, file: Path) -> None:
    rng = np.random.default_rng([plan.seed, i])
    poses = sample_reachable_poses(arm, n, rng, X_FT=plan.X_FT, floor=plan.floor, thin=plan.thin)
    partial = file.with_suffix(".part")
    with partial.open("wb") as stream:
        np.savez(stream, **poses._asdict())
    partial.replace(file)


def _load(file: Path) -> ReachedPoses:
    with np.load(file) as stored:
        quaternions, positions = stored["quaternions"], stored["positions"]
        counts = (int(stored[name]) for name in ReachedPoses._fields[2:])
        return ReachedPoses(quaternions, positions, *counts)


def _is_whole(file: Path) -> bool:
    try:
        with np.load(file) as stored:
            return set(ReachedPoses._fields) <= set(stored.files)
    except (FileNotFoundError, BadZipFile, ValueError, OSError):
        return False
