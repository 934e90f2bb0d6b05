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
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from feasigrasp.errors import ReachabilityError
from feasigrasp.inputs import read_json
from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, manipulability
from feasigrasp.outputs import write_json
from feasigrasp.runs.results.arguments import positive
from feasigrasp.runs.results.provenance import git_revision
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.mixtures.fit import fit_riemannian_mixture
from feasigrasp_lab.mixtures.mixture import bic
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.arguments import add_run_arguments, command_line, names
from feasigrasp_lab.results.rows import Row, write_csv, write_summary

#: Height in the base frame below which poses of the fitted frame are dropped [m]. Source: guessed.
FLOOR = 0.1


def manipulability_reference() -> float:
    """The manipulability from which on no draw is thinned out: exceeded by 1 draw in 10."""
    # Configurations that the quantile is taken of. Source: guessed.
    q = IIWA_7.random_positions(np.random.default_rng(0), 10_000)
    return float(np.quantile(manipulability(q), 0.9))


def sample_reachable_poses(
    n: int, rng: np.random.Generator, *, thin: float | None = None
) -> tuple[Array, dict[str, int]]:
    """Draws configurations and keeps the flange poses of those that are admissible.

    Args:
        n: Number of configurations to draw.
        rng: Source of randomness.
        thin: Keep a draw of manipulability m with probability m / thin, see
            `manipulability_reference`; keep all by default.

    Returns:
        Poses, shape (m, 4, 4) [m], and counts: configurations drawn, of these in self-collision
        (``colliding``), of the rest with the flange below the floor (``low``), of the rest
        ``thinned`` out, and ``reached``, those that are left.
    """
    q = IIWA_7.random_positions(rng, n)
    q = q[~in_collision(q)]
    X_WF = forward_kinematics(q)
    high = X_WF[:, 2, 3] >= FLOOR
    counts = {"drawn": n, "colliding": n - len(q), "low": len(q) - int(high.sum())}
    q, X_WF = q[high], X_WF[high]
    if thin is not None:
        X_WF = X_WF[rng.random(len(q)) * thin < manipulability(q)]
    return X_WF, counts | {"thinned": len(q) - len(X_WF), "reached": len(X_WF)}


#: Components of the mixtures that are compared. Source: definition.
SWEEP = (8, 16, 32, 64, 96, 128)
#: Arguments that decide the samples and the fits, beside the arm.
_DECISIVE = ("samples", "seed", "weighting")


class Weighting(StrEnum):
    """Which configurations count how much."""

    MANIPULABILITY = "manipulability"
    UNIFORM = "uniform"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/fit_reachability", jobs=False)
    parser.add_argument(
        "--samples", type=positive, default=1_000_000, help="Number of sampled configurations."
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
    X, counts = sample_reachable_poses(args.samples, np.random.default_rng(args.seed), thin=thin)
    print(", ".join(f"{value} {name}" for name, value in counts.items()))
    if len(X) < 1000:
        raise ReachabilityError(f"only {len(X)} poses were reached; raise --samples.")
    # One pose in 50 is put aside for the threshold.
    held_out, poses = X[: len(X) // 50], X[len(X) // 50 :]
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


def _fit(
    poses: Array, held_out: Array, k: int, seed: int, metadata: dict[str, Any]
) -> ReachableSpace:
    print(f"fitting {k} components to {len(poses)} poses")
    # At most 150 passes: a fit of 128 components ends before, by its tolerance.
    mixture = fit_riemannian_mixture(
        poses, k, np.random.default_rng([seed, k]), max_iterations=150, tolerance=2e-4
    )
    # Share of reachable poses whose log density exceeds the threshold.
    threshold = float(np.quantile(mixture.log_density(held_out), 1.0 - 0.99))
    likelihood = float(mixture.log_density(poses).mean())
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
