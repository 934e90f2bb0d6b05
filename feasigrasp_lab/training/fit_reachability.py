"""``feasigrasp fit reachability``: fit a Riemannian mixture to the reachable space of the arm."""

from __future__ import annotations

import argparse
import time
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from feasigrasp.errors import ReachabilityError
from feasigrasp.inputs import read_json
from feasigrasp.models.geometry import se3
from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab.mixtures.mixture import bic
from feasigrasp_lab.paper.float32_kernels import log_densities, pack
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.arguments import add_run_arguments, command_line
from feasigrasp_lab.results.rows import Row, write_csv, write_summary
from feasigrasp_lab.training.reachability.fit_mixture import LargeFit, fit_large_mixture
from feasigrasp_lab.training.reachability.pose_blocks import PoseBlocks
from feasigrasp_lab.training.reachability.reachable_poses import (
    ReachedPoses,
    draw_all,
    manipulability_reference,
    peak_memory_gb,
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
        default=3_500_000,
        help="Largest number of poses in the EM fit.",
    )
    parser.add_argument(
        "--components",
        default="128",
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
    start = time.perf_counter()
    components = parse_components(args.components)
    thin = manipulability_reference() if args.weighting == Weighting.MANIPULABILITY else None
    settings = {"arm": "iiwa", **{name: getattr(args, name) for name in _DECISIVE}}
    fresh = not (args.out / "settings.json").is_file()
    _keep_folder(args.out, settings)
    reached = draw_all(args.samples, args.seed, args.out / "samples", args.jobs, thin=thin)
    counts = {name: getattr(reached, name) for name in ReachedPoses._fields[2:]}
    counts["reached"] = len(reached.positions)
    print(", ".join(f"{value} {name}" for name, value in counts.items()))
    poses, held_out = split(reached, args.fit_poses, args.seed)
    del reached
    command, git = _command(args), git_revision()
    metadata = {
        **settings,
        "command": command,
        "git": git,
        "frame": "flange",
        "counts": {**counts, "fitted": poses.n, "held_out": len(held_out)},
    }
    fits = []
    for k in components:
        path = args.out / f"reachable_space_{k}.npz"
        if path.is_file():
            space = ReachableSpace.load(path)
        else:
            space = _fit(poses, held_out, k, args, metadata)
            space.save(path)
        fits.append(space)
    fits[-1].save(args.out / "reachable_space.npz")
    seconds = time.perf_counter() - start
    table = [(len(space.mixture), _bic(space), space.threshold) for space in fits]
    rows = [Row.plain("reachability.bic", f"K={k}", value, "1", poses.n) for k, value, _ in table]
    if fresh:  # a run that goes on where another one stopped says nothing about the whole
        preset = f"K={args.components}"
        rows.append(Row.plain("bench.reachability_fit_s", preset, seconds, "s", 1))
        rows.append(Row.plain("reachability.fit_memory_gb", preset, peak_memory_gb(), "GB", 1))
    write_csv(args.out / "bic.csv", sorted(table), ("components", "bic", "threshold"))
    write_summary(args.out / "summary.json", command, git, args.seed, rows, counts=counts)
    for k, value, threshold in table:
        print(f"K = {k:4d}   BIC {value:.6g}   99 % threshold {threshold:.3f}")
    print(f"{seconds:.1f} s, at most {peak_memory_gb():.2f} GB; {args.out}/reachable_space.npz")
    return 0


def parse_components(text: str) -> tuple[int, ...]:
    """Reads ``--components``.

    Raises:
        ReachabilityError: It is neither ``sweep`` nor a list of positive numbers.
    """
    if text == "sweep":
        return SWEEP
    try:
        numbers = tuple(int(word) for word in text.split(","))
    except ValueError:
        numbers = ()
    if not numbers or min(numbers) < 1:
        raise ReachabilityError(f"--components {text}: give e.g. 64,128 or sweep")
    return numbers


def split(reached: ReachedPoses, fit_poses: int, seed: int) -> tuple[PoseBlocks, np.ndarray]:
    """Puts aside 2 % of the poses, at most 200 000, and sorts at most ``fit_poses`` of the rest.

    Returns:
        What EM sees, and what the threshold comes from, shape (h, 4, 4).

    Raises:
        ReachabilityError: Too few poses were reached.
    """
    n = len(reached.positions)
    if n < 1000:
        raise ReachabilityError(f"only {n} poses were reached; raise --samples.")
    held_out = np.random.default_rng([seed, n]).choice(n, min(n // 50, 200_000), replace=False)
    rest = np.ones(n, dtype=bool)
    rest[held_out] = False
    chosen = np.flatnonzero(rest)[:fit_poses]  # draws are independent: the first are as good
    X = se3.make_pose(se3.rotations(reached.quaternions[held_out]), reached.positions[held_out])
    return PoseBlocks.of(reached.quaternions[chosen], reached.positions[chosen]), X


def _fit(
    poses: PoseBlocks,
    held_out: np.ndarray,
    k: int,
    args: argparse.Namespace,
    metadata: dict[str, Any],
) -> ReachableSpace:
    fit = LargeFit(threads=args.jobs)
    with tqdm(total=fit.max_iterations, unit="pass", desc=f"K = {k}") as bar:

        def progress(stage: str, i: int, likelihood: float) -> None:
            bar.set_postfix_str(f"{stage} {i}, {likelihood:.4f}", refresh=False)
            bar.update(stage == "all")

        rng = np.random.default_rng([args.seed, k])
        mixture, likelihood = fit_large_mixture(poses, k, rng, fit, progress)
    # Share of reachable poses whose log density exceeds the threshold.
    threshold = float(np.quantile(log_densities(held_out, pack(mixture)), 1.0 - 0.99))
    return ReachableSpace(mixture, threshold, {**metadata, "log_likelihood_per_pose": likelihood})


def _bic(space: ReachableSpace) -> float:
    n = space.metadata["counts"]["fitted"]
    return bic(len(space.mixture), n, n * space.metadata["log_likelihood_per_pose"])


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


def _command(args: argparse.Namespace) -> str:
    names = ["samples", "fit_poses", "components", "weighting", "seed"]
    given = argparse.Namespace(**{name: getattr(args, name) for name in names})
    return command_line(given, "fit reachability")
