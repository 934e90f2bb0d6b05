"""``feasigrasp evaluate reachability``: compare the mixture with exact inverse kinematics."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from feasigrasp.errors import ReachabilityError
from feasigrasp.evaluation.measures.roc import area_under_curve, roc_curve
from feasigrasp.evaluation.peers.reachability import FlatMixture, VoxelMap
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.mixtures.float32_kernels import log_densities, pack
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.models.reach.reachable_space import ReachableSpace
from feasigrasp.results.arguments import add_common_arguments, positive
from feasigrasp.results.rows import Row, report_rows, write_csv
from feasigrasp.results.statistics import proportion
from feasigrasp.training.reachability.fit_mixture import LargeFit, fit_large_mixture
from feasigrasp.training.reachability.pose_blocks import PoseBlocks
from feasigrasp.training.reachability.reachable_poses import (
    IiwaArm,
    manipulability_reference,
    sample_reachable_poses,
)

#: Where the random poses lie [m].
LOWEST, HIGHEST = (-0.9, -0.9, 0.1), (0.9, 0.9, 1.25)
#: Components of the paper's mixture.
PAPER_COMPONENTS = 64
LABELS = {
    "rmm": "RMM, shipped",
    "rmm-paper": "RMM, K = 64, uniform draws (paper)",
    "gmm": "GMM on flattened poses (Kim 2014)",
    "gmm-paper": "GMM, uniform draws",
    "voxel": "voxel map",
}


@dataclass(frozen=True, eq=False)
class Judge:
    """A score of poses, and from which value on a pose counts as reachable.

    Attributes:
        score: Scores of poses (n, 4, 4), shape (n,).
        threshold: 99 % of reached poses score at least that.
    """

    score: Callable[[Array], Array]
    threshold: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/reachability", objects="builtin")
    parser.add_argument("--poses", type=positive, default=6000, help="random poses to judge")
    parser.add_argument("--file", type=Path, help="reachable space; the shipped one by default")
    parser.add_argument(
        "--peer_poses",
        type=positive,
        default=200_000,
        help="reached poses that peers are fitted to",
    )
    parser.add_argument(
        "--voxel_draws", type=positive, default=4_000_000, help="configurations in the voxel map"
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.quick:
        args.poses, args.peer_poses = min(args.poses, 2000), min(args.peer_poses, 20_000)
        args.voxel_draws = min(args.voxel_draws, 1_000_000)
    space = ReachableSpace.load(args.file) if args.file else ReachableSpace.load_default()
    if not np.allclose(space.metadata.get("X_FT", np.eye(4)), np.eye(4)):
        raise ReachabilityError(f"{args.file} is about a tool; only flange poses are compared here")
    rng = np.random.default_rng(args.seed)
    X = random_poses(rng, args.poses)
    reachable = exact(X)
    out: Path = args.out
    out.mkdir(parents=True, exist_ok=True)
    scores: dict[str, Array] = {}
    thresholds: dict[str, float] = {}
    for name in tqdm(LABELS, desc="judges"):
        # A finished judge is kept: the same command goes on where it was interrupted.
        key = f"{name}-{args.seed}-{args.poses}-{args.peer_poses}-{args.voxel_draws}"
        file = out / "judges" / f"{key}.npz"
        if name != "rmm" and file.is_file():
            with np.load(file) as stored:
                scores[name], thresholds[name] = stored["score"], float(stored["threshold"])
            continue
        judge = _judge(name, space, args)
        scores[name], thresholds[name] = judge.score(X), judge.threshold
        if name != "rmm":
            file.parent.mkdir(exist_ok=True)
            np.savez(file, score=scores[name], threshold=thresholds[name])
    rows = [
        row for name in LABELS for row in _rows(name, scores[name], thresholds[name], reachable)
    ]
    _write_poses(X, reachable, scores, out / "poses.csv")
    _write_curves(scores, thresholds, reachable, out)
    share = float(reachable.mean())
    print(f"{share:.1%} of {len(X)} random poses are reachable")
    report_rows(args, "evaluate reachability", rows, reachable_share=share)
    return 0


def random_poses(rng: np.random.Generator, n: int) -> Array:
    """Poses with uniform rotations and positions in the evaluation's box, shape (n, 4, 4) [m]."""
    X = se3.random_pose(rng, n)
    X[:, :3, 3] = rng.uniform(LOWEST, HIGHEST, (n, 3))
    return X


def exact(X_WF: Array) -> Mask:
    """Whether some configuration inside the limits, free of self-collision, has a flange pose."""
    judge = Reachability(n_arm_angles=90, limit_margin=0.0, clearance=0.0, table_height=-100.0)
    return np.asarray(judge.flange_verdicts(X_WF) == REACHABLE)


def _judge(name: str, space: ReachableSpace, args: argparse.Namespace) -> Judge:
    rng = np.random.default_rng([args.seed, list(LABELS).index(name)])
    if name == "rmm":
        return Judge(space.log_density, space.threshold)
    if name == "voxel":
        voxels = VoxelMap(_reached(rng, args.voxel_draws, thin=False))
        return _with_threshold(voxels.score, _reached(rng, args.peer_poses, thin=False))
    X = _reached(rng, 4 * args.peer_poses, thin=not name.endswith("paper"))[: args.peer_poses]
    held_out, X = X[: len(X) // 5], X[len(X) // 5 :]
    if name.startswith("gmm"):
        flat = FlatMixture.fit(X, len(space.mixture), rng)
        return _with_threshold(flat.log_density, held_out)
    q = se3.quaternions(X)
    fit = LargeFit(threads=args.jobs)
    mixture, _ = fit_large_mixture(PoseBlocks.of(q, X[:, :3, 3]), PAPER_COMPONENTS, rng, fit)
    packed = pack(mixture)
    return _with_threshold(lambda poses: log_densities(poses, packed), held_out)


def _with_threshold(score: Callable[[Array], Array], held_out: Array) -> Judge:
    return Judge(score, float(np.quantile(score(held_out), 0.01)))


def _reached(rng: np.random.Generator, draws: int, thin: bool) -> Array:
    """Reached flange poses, shape (n, 4, 4)."""
    arm, parts = IiwaArm(), []
    reference = manipulability_reference(arm) if thin else None
    for start in range(0, draws, 250_000):
        part = sample_reachable_poses(arm, min(250_000, draws - start), rng, thin=reference)
        parts.append(se3.make_pose(se3.rotations(part.quaternions), part.positions))
    return np.concatenate(parts)


def _judged(name: str, score: Array, threshold: float) -> Mask:
    """Which poses count as reachable; of the voxel map, a count of zero is no evidence of reach."""
    verdict: Mask = (score >= threshold) & ((score > 0.0) | (name != "voxel"))
    return verdict


def _rows(name: str, score: Array, threshold: float, reachable: Mask) -> list[Row]:
    judged = _judged(name, score, threshold)
    auc = area_under_curve(score, reachable)
    family, _, variant = name.partition("-")
    rows = [Row.of(f"reachability.auc.{family}", variant or "default", auc, "1")]
    for figure, hits, n in (
        ("accuracy", judged == reachable, len(reachable)),
        ("precision", (judged & reachable)[judged], int(judged.sum())),
        ("recall", judged[reachable], int(reachable.sum())),
        ("false_positive_percent", judged[~reachable], int((~reachable).sum())),
    ):
        percent = figure.endswith("percent")
        estimate = proportion(int(np.sum(hits)), max(n, 1))
        unit, factor = ("%", 100.0) if percent else ("1", 1.0)
        rows.append(Row.of(f"reachability.{figure}", name, estimate, unit, factor))
    return rows


def _write_poses(X: Array, reachable: Mask, scores: dict[str, Array], filename: Path) -> None:
    heads = ("qw", "qx", "qy", "qz", "x", "y", "z", "reachable", *scores)
    table = np.column_stack([se3.quaternions(X), X[:, :3, 3], reachable, *scores.values()])
    write_csv(filename, table.tolist(), heads, ".7g")


def _write_curves(
    scores: dict[str, Array],
    thresholds: dict[str, float],
    reachable: Mask,
    out: Path,
) -> None:
    figure, lines = Figure(figsize=(5.2, 4.4), layout="constrained"), []
    axes = figure.subplots()
    for index, (name, score) in enumerate(scores.items()):
        false, true = roc_curve(score, reachable)
        label = f"{LABELS[name]}: {area_under_curve(score, reachable).value:.3f}"
        axes.plot(false, true, label=label, color=f"C{index}")
        judged = _judged(name, score, thresholds[name])
        axes.plot(judged[~reachable].mean(), judged[reachable].mean(), "o", color=f"C{index}")
        lines += [(name, float(f), float(t)) for f, t in zip(false, true, strict=True)]
    write_csv(
        out / "roc.csv", lines, ("judge", "false_positive_share", "true_positive_share"), ".5f"
    )
    axes.plot([0, 1], [0, 1], ":", color="0.6")
    axes.set(xlabel="share of unreachable poses taken for reachable", xlim=(0, 1))
    axes.set(ylabel="share of reachable poses found", ylim=(0, 1.005))
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(out / "roc.png", dpi=150)
