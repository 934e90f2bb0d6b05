"""``feasigrasp fit reachability``: fit a Riemannian mixture to the reachable space of the arm.

Joint positions are uniform inside their limits. Configurations in self-collision, and poses of the
fitted frame below a floor, are dropped (the paper's section IV-B).

What remains is dense where the arm is close to singular: near a configuration with manipulability m
= sqrt(det J J^T), poses have density 1/m. A mixture fitted to them describes those crowds first.
Where it is to separate reachable poses from others, draws can be *thinned* in proportion to m: what
is left has, at every pose, a density proportional to the self-motion that the arm has there,
without singular crowds.
"""

import argparse
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from joblib.externals.loky import get_reusable_executor
from numpy.typing import NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.inputs import read_json
from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability
from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.mixtures.fit import fit_riemannian_mixture
from feasigrasp_lab.mixtures.mixture import bic
from feasigrasp_lab.paper.float32_kernels import log_densities, pack
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.arguments import add_run_arguments, command_line, names
from feasigrasp_lab.results.finished import make_shards, read_shard, write_arrays
from feasigrasp_lab.results.rows import Row, write_csv, write_summary

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


#: Components of the mixtures that are compared. Source: definition.
SWEEP = (8, 16, 32, 64, 96, 128)
#: Arguments that decide the samples and the fits, beside the arm.
_DECISIVE = ("samples", "fit_poses", "seed", "weighting")


class Weighting(StrEnum):
    """Which configurations count how much."""

    MANIPULABILITY = "manipulability"
    UNIFORM = "uniform"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/fit_reachability")
    parser.add_argument(
        "--samples", type=positive, default=10_000_000, help="Number of sampled configurations."
    )
    parser.add_argument(
        "--fit-poses",
        type=positive,
        default=1_000_000,
        help="Largest number of poses in the EM fit.",
    )
    parser.add_argument(
        "--components",
        type=component_counts,
        default=[128],
        help=f"Numbers of components, separated by commas; 'sweep' is {','.join(map(str, SWEEP))}. "
        "The fit with the last one is written as reachable_space.npz.",
    )
    parser.add_argument(
        "--weighting",
        choices=tuple(map(str, Weighting)),
        default=str(Weighting.MANIPULABILITY),
        help="Weights of the poses. 'uniform': those of uniform configurations, as in the paper; "
        "'manipulability': fewer poses close to singularities, which classifies better.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    thin = manipulability_reference() if args.weighting == Weighting.MANIPULABILITY else None
    settings = {"arm": "iiwa", **{name: getattr(args, name) for name in _DECISIVE}}
    _keep_folder(args.out, settings)
    reached = draw_all(args.samples, args.seed, args.out / "samples", args.jobs, thin=thin)
    counts = {name: getattr(reached, name) for name in ReachedPoses._fields[2:]}
    counts["reached"] = len(reached.positions)
    print(", ".join(f"{value} {name}" for name, value in counts.items()))
    poses, held_out = split(reached, args.fit_poses, args.seed)
    del reached
    command, git = command_line(args, "fit reachability"), git_revision()
    metadata = {
        **settings,
        "command": command,
        "git": git,
        "frame": "flange",
        "counts": {**counts, "fitted": len(poses), "held_out": len(held_out)},
    }
    fits = []
    for k in args.components:
        path = args.out / f"reachable_space_{k}.npz"
        if path.is_file():
            space = ReachableSpace.load(path)
        else:
            space = _fit(poses, held_out, k, args.seed, metadata)
            space.save(path)
        fits.append(space)
    fits[-1].save(args.out / "reachable_space.npz")
    table = []
    for space in fits:
        n, k = space.metadata["counts"]["fitted"], len(space.mixture)
        likelihood = n * space.metadata["log_likelihood_per_pose"]
        table.append((k, bic(k, n, likelihood), space.threshold))
    rows = [
        Row.plain("reachability.bic", f"K={k}", value, "1", len(poses)) for k, value, _ in table
    ]
    write_csv(args.out / "bic.csv", sorted(table), ("components", "bic", "threshold"))
    write_summary(args.out / "summary.json", command, git, args.seed, rows, counts=counts)
    for k, value, threshold in table:
        print(f"K = {k:4d}   BIC {value:.6g}   99 % threshold {threshold:.3f}")
    print(f"the last one is in {args.out}/reachable_space.npz")
    return 0


def component_counts(text: str) -> list[int]:
    """Reads ``--components``: ``sweep``, or numbers that are separated by commas."""
    return [*SWEEP] if text == "sweep" else [positive(word) for word in names(text)]


def split(reached: ReachedPoses, fit_poses: int, seed: int) -> tuple[Array, Array]:
    """Puts aside 2 % of the poses, at most 200 000, and takes at most ``fit_poses`` of the rest.

    Returns:
        What EM sees, shape (n, 4, 4), and what the threshold comes from, shape (h, 4, 4).

    Raises:
        ReachabilityError: Too few poses were reached.
    """
    n = len(reached.positions)
    if n < 1000:
        raise ReachabilityError(f"only {n} poses were reached; raise --samples.")
    held_out = np.random.default_rng([seed, n]).choice(n, min(n // 50, 200_000), replace=False)
    rest = np.ones(n, dtype=bool)
    rest[held_out] = False
    fitted = np.flatnonzero(rest)[:fit_poses]  # draws are independent: the first are as good
    q, p = reached.quaternions.astype(float), reached.positions.astype(float)
    poses, aside = (se3.make_pose(se3.rotations(q[i]), p[i]) for i in (fitted, held_out))
    return poses, aside


def _fit(
    poses: Array, held_out: Array, k: int, seed: int, metadata: dict[str, Any]
) -> ReachableSpace:
    print(f"fitting {k} components to {len(poses)} poses")
    # At most 150 passes: a fit of 128 components ends before, by its tolerance.
    mixture = fit_riemannian_mixture(
        poses, k, np.random.default_rng([seed, k]), max_iterations=150, tolerance=2e-4
    )
    packed = pack(mixture)
    # Share of reachable poses whose log density exceeds the threshold.
    threshold = float(np.quantile(log_densities(held_out, packed), 1.0 - 0.99))
    likelihood = float(log_densities(poses, packed).mean())
    return ReachableSpace(mixture, threshold, {**metadata, "log_likelihood_per_pose": likelihood})


def _keep_folder(out: Path, settings: dict[str, Any]) -> None:
    """Notes the settings of a folder; results of other settings are not mixed in.

    Raises:
        ReachabilityError: The folder was made with other settings.
    """
    file = out / "settings.json"
    if not file.is_file():
        write_json(settings, file)
    elif read_json(file) != settings:
        raise ReachabilityError(f"{out} holds results of other settings; give another --out")
