"""``feasigrasp evaluate reachability``: compare densities of reachable poses with exact IK.

Presets ``rmm`` and ``rmm-paper`` are the packaged spaces, the second with as many components, and
fitted to the same draws, as the paper's.
"""

import argparse
from pathlib import Path

import numpy as np

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.paper.reachable_space import ReachableSpace, SpaceName
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.results.statistics import area_under_curve, proportion


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/reachability", objects="builtin")
    parser.add_argument(
        "--poses", type=positive, default=6000, help="Number of random poses to classify."
    )
    parser.add_argument(
        "--file", type=Path, help="Reachable space, an npz file. Default: the packaged one."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.quick:
        args.poses = min(args.poses, 2000)
    X = random_poses(np.random.default_rng(args.seed), args.poses)
    reachable = exact(X)
    spaces = {
        "rmm": ReachableSpace.load(args.file) if args.file else ReachableSpace.load_named(),
        "rmm-paper": ReachableSpace.load_named(SpaceName.PAPER),
    }
    scores = {name: space.log_density(X) for name, space in spaces.items()}
    rows = [
        row
        for name, space in spaces.items()
        for row in _rows(name, scores[name], scores[name] >= space.threshold, reachable)
    ]
    heads = ("qw", "qx", "qy", "qz", "x", "y", "z", "reachable", *scores)
    table = np.column_stack([se3.quaternions(X), X[:, :3, 3], reachable, *scores.values()])
    write_csv(args.out / "poses.csv", table.tolist(), heads, ".7g")
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
