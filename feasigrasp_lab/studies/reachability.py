"""``feasigrasp evaluate reachability``: compare the mixture with exact inverse kinematics."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.paper.float32_kernels import log_densities, pack
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.finished import finished_arrays, write_arrays
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import area_under_curve, proportion, roc_curve
from feasigrasp_lab.training.reachability.fit_mixture import LargeFit, fit_large_mixture
from feasigrasp_lab.training.reachability.pose_blocks import PoseBlocks
from feasigrasp_lab.training.reachability.reachable_poses import (
    IiwaArm,
    sample_reachable_poses,
)

#: Components of the paper's mixture, and draws behind its threshold. Source: paper.
PAPER_COMPONENTS, HELD_OUT = 64, 200_000
LABELS = {
    "rmm": "RMM, shipped",
    "rmm-paper": "RMM, K = 64, uniform draws (paper)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/reachability", objects="builtin")
    parser.add_argument(
        "--poses", type=positive, default=6000, help="Number of random poses to classify."
    )
    parser.add_argument(
        "--file", type=Path, help="Reachable space, an npz file. Default: the packaged one."
    )
    parser.add_argument(
        "--paper-poses",
        type=positive,
        help="Number of reached poses for the fit of the paper's mixture. Default: as for ours.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    space = ReachableSpace.load(args.file) if args.file else ReachableSpace.load_default()
    if args.paper_poses is None:
        counts = space.metadata.get("counts", {"fitted": HELD_OUT})
        args.paper_poses = int(counts["fitted"])
    if args.quick:
        args.paper_poses = min(args.paper_poses, 200_000)
        args.poses = min(args.poses, 2000)
    rng = np.random.default_rng(args.seed)
    X = random_poses(rng, args.poses)
    reachable = exact(X)
    out: Path = args.out
    out.mkdir(parents=True, exist_ok=True)
    scores, verdicts = dict[str, Array](), dict[str, Mask]()
    for name in tqdm(LABELS, desc="judges"):
        # A finished judge is kept: the same command goes on where it was interrupted.
        key = f"{name}-{args.seed}-{args.poses}-{args.paper_poses}"
        file = out / "judges" / f"{key}.npz"
        stored = finished_arrays(file) if name != "rmm" else None
        if stored is not None:
            score, threshold = stored["score"], float(stored["threshold"])
        else:
            score, threshold = _score(name, X, space, args)
            if name != "rmm":
                write_arrays(file, {"score": score, "threshold": threshold}, compressed=False)
        scores[name] = score
        verdicts[name] = score >= threshold
    rows = [row for name in LABELS for row in _rows(name, scores[name], verdicts[name], reachable)]
    heads = ("qw", "qx", "qy", "qz", "x", "y", "z", "reachable", *scores)
    table = np.column_stack([se3.quaternions(X), X[:, :3, 3], reachable, *scores.values()])
    write_csv(out / "poses.csv", table.tolist(), heads, ".7g")
    _write_curves(scores, verdicts, reachable, out)
    share = float(reachable.mean())
    print(f"{share:.1%} of {len(X)} random poses are reachable")
    report_rows(args, "evaluate reachability", rows, reachable_share=share)
    return 0


def random_poses(rng: np.random.Generator, n: int) -> Array:
    """Poses with uniform rotations and positions in the evaluation's box, shape (n, 4, 4) [m]."""
    # Where the random poses lie [m].
    lowest, highest = (-0.9, -0.9, 0.1), (0.9, 0.9, 1.25)
    X = se3.random_pose(rng, n)
    X[:, :3, 3] = rng.uniform(lowest, highest, (n, 3))
    return X


def exact(X_WF: Array) -> Mask:
    """Whether some configuration inside the limits, free of self-collision, has a flange pose."""
    judge = Reachability(n_arm_angles=90, limit_margin=0.0, clearance=0.0, table_height=-100.0)
    return np.asarray(judge.flange_verdicts(X_WF) == REACHABLE)


def _score(
    name: str, X: Array, space: ReachableSpace, args: argparse.Namespace
) -> tuple[Array, float]:
    """Scores (n,) of poses (n, 4, 4), and what 99 % of reached poses score at least."""
    rng = np.random.default_rng([args.seed, list(LABELS).index(name)])
    if name == "rmm":
        return space.log_density(X), space.threshold
    blocks = _reached_blocks(rng, args.paper_poses)
    mixture, _ = fit_large_mixture(blocks, PAPER_COMPONENTS, rng, LargeFit(threads=args.jobs))
    drawn = sample_reachable_poses(IiwaArm(), HELD_OUT, rng)
    held_out = se3.make_pose(se3.rotations(drawn.quaternions), drawn.positions)
    packed = pack(mixture)
    return log_densities(X, packed), float(np.quantile(log_densities(held_out, packed), 0.01))


def _reached_blocks(rng: np.random.Generator, count: int) -> PoseBlocks:
    """So many reached flange poses of uniform draws, packed as they come: millions fit."""
    arm, quaternions, positions, there = IiwaArm(), [], [], 0
    while there < count:
        part = sample_reachable_poses(arm, 250_000, rng)
        quaternions.append(part.quaternions)
        positions.append(part.positions)
        there += len(part.positions)
    return PoseBlocks.of(np.concatenate(quaternions)[:count], np.concatenate(positions)[:count])


def _rows(name: str, score: Array, judged: Mask, reachable: Mask) -> list[Row]:
    family, _, variant = name.partition("-")
    auc = area_under_curve(score, reachable)
    rows = [Row.of(f"reachability.auc.{family}", variant or "default", auc, "1")]
    for figure, hits in (
        ("accuracy", judged == reachable),
        ("precision", reachable[judged]),
        ("recall", judged[reachable]),
    ):
        share = proportion(int(hits.sum()), len(hits))
        rows.append(Row.of(f"reachability.{figure}", name, share, "1"))
    wrong = judged[~reachable]
    rows.append(Row.percent("reachability.false_positive_percent", name, wrong))
    return rows


def _write_curves(
    scores: dict[str, Array], verdicts: dict[str, Mask], reachable: Mask, out: Path
) -> None:
    figure, lines = Figure(figsize=(5.2, 4.4), layout="constrained"), []
    axes = figure.subplots()
    for index, (name, score) in enumerate(scores.items()):
        false, true = roc_curve(score, reachable)
        label = f"{LABELS[name]}: {area_under_curve(score, reachable).value:.3f}"
        axes.plot(false, true, label=label, color=f"C{index}")
        judged = verdicts[name]
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
    save_figure(figure, out / "roc.png", dpi=150)
