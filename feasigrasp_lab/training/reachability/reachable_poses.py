"""Samples of reachable poses from random configurations.

Joint positions are uniform inside their limits. Configurations in self-collision, and poses of the
fitted frame below a floor, are dropped (the paper's section IV-B).

What remains is dense where the arm is close to singular: near a configuration with manipulability m
= sqrt(det J J^T), poses have density 1/m. A mixture fitted to them describes those crowds first.
Where it is to separate reachable poses from others, draws can be *thinned* in proportion to m: what
is left has, at every pose, a density proportional to the self-motion that the arm has there,
without singular crowds.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib.externals.loky import get_reusable_executor
from numpy.typing import NDArray

from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability
from feasigrasp_lab.arm.self_collision import in_collision
from feasigrasp_lab.results.finished import make_shards, read_shard, write_arrays

#: Height in the base frame below which poses of the fitted frame are dropped [m]. Source: guessed.
FLOOR = 0.1
#: Configurations of a part on disk; each part has its own stream of random numbers. Source:
#: numerical.
PART = 250_000


class ReachedPoses(NamedTuple):
    """Poses that were reached, and what became of the draws that brought none.

    Attributes:
        quaternions: Unit quaternions wxyz, shape (m, 4), single precision.
        positions: Shape (m, 3) [m], single precision.
        drawn: Number of configurations drawn.
        colliding: How many of them were in self-collision.
        low: How many of the others put the fitted frame below the floor.
        thinned: How many of the rest were thinned out.
    """

    quaternions: NDArray[np.float32]
    positions: NDArray[np.float32]
    drawn: int
    colliding: int
    low: int
    thinned: int


def manipulability_reference() -> float:
    """The manipulability from which on no draw is thinned out: exceeded by 1 draw in 10."""
    # Configurations that the quantile is taken of. Source: guessed.
    q = IIWA_7.random_positions(np.random.default_rng(0), 10_000)
    return float(np.quantile(manipulability(q), 0.9))


def sample_reachable_poses(
    n: int, rng: np.random.Generator, *, thin: float | None = None
) -> ReachedPoses:
    """Draws configurations and keeps the flange poses of those that are admissible.

    Args:
        n: Number of configurations to draw; a few hundred thousand at a time.
        rng: Source of randomness.
        thin: Keep a draw of manipulability m with probability m / thin, see
            `manipulability_reference`; keep all by default.
    """
    q = IIWA_7.random_positions(rng, n)
    q = q[~in_collision(q)]
    X_WF = forward_kinematics(q)
    high = X_WF[:, 2, 3] >= FLOOR
    n_free, n_high = len(q), int(high.sum())
    if thin is not None:
        high[high] = rng.random(n_high) * thin < manipulability(q[high])
    X_WF = X_WF[high]
    return ReachedPoses(
        se3.quaternions(X_WF).astype(np.float32),
        X_WF[:, :3, 3].astype(np.float32),
        drawn=n,
        colliding=n - n_free,
        low=n_free - n_high,
        thinned=n_high - len(X_WF),
    )


def join(parts: Sequence[ReachedPoses]) -> ReachedPoses:
    """All the poses and counts of several samples."""
    quaternions, positions, *counts = zip(*parts, strict=True)
    return ReachedPoses(
        np.concatenate(quaternions), np.concatenate(positions), *(sum(count) for count in counts)
    )


def draw_all(n: int, seed: int, folder: Path, jobs: int, *, thin: float | None) -> ReachedPoses:
    """Draws what a folder does not have yet; the result does not depend on what it has.

    Args:
        n: Number of configurations.
        seed: Seed of all of them.
        folder: Where the parts are kept.
        jobs: Processes at a time.
        thin: See `sample_reachable_poses`.
    """
    sizes = [min(PART, n - start) for start in range(0, n, PART)]
    files = [folder / f"part-{i:04d}.npz" for i in range(len(sizes))]
    draw = partial(_draw_part, sizes=sizes, seed=seed, thin=thin)
    make_shards(files, draw, jobs=jobs, desc="sampling")
    if jobs > 1:
        get_reusable_executor().shutdown(wait=True)  # what comes next needs the memory
    return join([_load(file) for file in files])


def peak_memory_gb() -> float:
    """The most memory that this process, and any one of its finished children, have held [GB]."""
    usage = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(u.ru_maxrss for u in usage) / 1e6


def _draw_part(file: Path, i: int, *, sizes: list[int], seed: int, thin: float | None) -> bool:
    poses = sample_reachable_poses(sizes[i], np.random.default_rng([seed, i]), thin=thin)
    write_arrays(file, poses._asdict(), compressed=False)
    return True


def _load(file: Path) -> ReachedPoses:
    stored = read_shard(file, ReachedPoses._fields)
    quaternions, positions = stored["quaternions"], stored["positions"]
    return ReachedPoses(
        quaternions, positions, *(int(stored[name]) for name in ReachedPoses._fields[2:])
    )
