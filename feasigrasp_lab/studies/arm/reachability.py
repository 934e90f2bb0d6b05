"""``feasigrasp evaluate reachability``: compare the mixture with exact inverse kinematics."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.cluster.vq import kmeans2
from scipy.special import logsumexp
from tqdm import tqdm

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.arguments import add_common_arguments, positive
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp.runs.results.statistics import area_under_curve, proportion, roc_curve
from feasigrasp_lab.paper.float32_kernels import log_densities, pack
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.results.finished import finished_arrays, write_arrays
from feasigrasp_lab.training.reachability.fit_mixture import LargeFit, fit_large_mixture
from feasigrasp_lab.training.reachability.pose_blocks import PoseBlocks
from feasigrasp_lab.training.reachability.reachable_poses import (
    IiwaArm,
    manipulability_reference,
    sample_reachable_poses,
)

#: Variance added to each of the twelve dimensions of the flat mixture: rotation matrices fill only
#: three of their nine, so that without it every covariance is singular.
FLOOR = 1e-2


def flatten(X: Array) -> Array:
    """Rotation matrix and position as one vector, shape (n, 12)."""
    return np.concatenate([X[:, :3, :3].reshape(-1, 9), X[:, :3, 3]], axis=1)


@dataclass(frozen=True, eq=False)
class FlatMixture:
    """A Gaussian mixture over flattened poses (Kim et al., "Catching Objects in Flight", 2014).

    A log density is linear in the poses' products ``(1, x_i, x_i x_j)``, so that both steps of EM
    are matrix products.

    Attributes:
        coefficients: Log density with weight over these products, shape (91, K).
    """

    coefficients: Array

    @classmethod
    def fit(
        cls, X: Array, n_components: int, rng: np.random.Generator, iterations: int = 25
    ) -> FlatMixture:
        """Fits poses (n, 4, 4), starting at k-means++ clusters."""
        x = flatten(X)
        _, label = kmeans2(x, n_components, iter=5, minit="++", seed=rng)
        features = _products(x)
        r = np.zeros((len(x), n_components))
        r[np.arange(len(x)), label] = 1.0
        for _ in range(iterations):
            mixture = cls(_maximize(r.T @ features))
            log = features @ mixture.coefficients
            r = np.exp(log - logsumexp(log, axis=1, keepdims=True))
        return mixture

    def log_density(self, X: Array) -> Array:
        """Log density of poses (n, 4, 4), shape (n,)."""
        return np.asarray(logsumexp(_products(flatten(X)) @ self.coefficients, axis=1))


def _products(x: Array) -> Array:
    """``(1, x_i, x_i x_j with j <= i)``, shape (n, 91)."""
    rows, columns = np.tril_indices(x.shape[1])
    return np.concatenate([np.ones((len(x), 1)), x, x[:, rows] * x[:, columns]], axis=1)


def _maximize(moments: Array) -> Array:
    """Coefficients of the components from the sums of the products under each, shape (K, 91)."""
    moments = moments[moments[:, 0] > 12.0]
    rows, columns = np.tril_indices(12)
    coefficients = []
    for m in moments:
        mean, second = m[1:13] / m[0], np.zeros((12, 12))
        second[rows, columns] = second[columns, rows] = m[13:] / m[0]
        covariance = second - np.outer(mean, mean) + FLOOR * np.eye(12)
        precision = np.linalg.inv(covariance)
        constant = np.log(m[0] / moments[:, 0].sum()) - 6.0 * np.log(2.0 * np.pi)
        constant -= 0.5 * (np.linalg.slogdet(covariance)[1] + mean @ precision @ mean)
        square = np.where(rows == columns, -0.5, -1.0) * precision[rows, columns]
        coefficients.append(np.concatenate([[constant], precision @ mean, square]))
    return np.array(coefficients).T


class VoxelMap:
    """Counts of reached poses in cells: position x approach direction x roll about it.

    Directions are the 26 of a cube's faces, edges and corners; positions and rolls are even.
    """

    def __init__(self, X: Array, voxel: float = 0.1, rolls: int = 8) -> None:
        """Counts poses (n, 4, 4).

        Args:
            X: Reached poses.
            voxel: Edge of a position cell [m].
            rolls: Number of cells of the roll angle.
        """
        steps = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1)
        steps = steps.reshape(-1, 3)
        steps = steps[np.abs(steps).sum(axis=1) > 0]
        self._directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
        self._voxel, self._rolls = voxel, rolls
        self._cells, self._counts = np.unique(self._cell(X), return_counts=True)

    def score(self, X: Array) -> Array:
        """How many of the counted poses share the cells of poses (n, 4, 4), shape (n,)."""
        cell = self._cell(X)
        index = np.minimum(np.searchsorted(self._cells, cell), len(self._cells) - 1)
        return np.where(self._cells[index] == cell, self._counts[index], 0).astype(float)

    def _cell(self, X: Array) -> Indices:
        z, x = X[:, :3, 2], X[:, :3, 0]
        direction = np.argmax(z @ self._directions.T, axis=1)
        # Roll against the horizontal that is perpendicular to z (against x, if z is vertical).
        side = np.stack([-z[:, 1], z[:, 0], np.zeros(len(z))], axis=1)
        side[np.hypot(z[:, 0], z[:, 1]) < 1e-9] = (1.0, 0.0, 0.0)
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        up = np.cross(z, side)
        angle = np.arctan2(np.einsum("ni,ni->n", x, up), np.einsum("ni,ni->n", x, side))
        roll = np.floor((angle / (2 * np.pi) + 0.5) * self._rolls).astype(np.int64) % self._rolls
        position = np.floor(X[:, :3, 3] / self._voxel).astype(np.int64) + 64
        cell = (position[:, 0] * 128 + position[:, 1]) * 128 + position[:, 2]
        return (cell * len(self._directions) + direction) * self._rolls + roll


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
        "--peer-poses",
        type=positive,
        default=200_000,
        help="Number of reached poses for the fits of flat mixtures; one fifth is held out.",
    )
    parser.add_argument(
        "--paper-poses",
        type=positive,
        help="Number of reached poses for the fit of the paper's mixture. Default: as for ours.",
    )
    parser.add_argument(
        "--voxel-draws",
        type=positive,
        default=4_000_000,
        help="Number of configurations in the voxel map.",
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    space = ReachableSpace.load(args.file) if args.file else ReachableSpace.load_default()
    if args.paper_poses is None:
        counts = space.metadata.get("counts", {"fitted": args.peer_poses})
        args.paper_poses = int(counts["fitted"])
    if args.quick:
        args.paper_poses = min(args.paper_poses, 200_000)
        args.poses, args.peer_poses = min(args.poses, 2000), min(args.peer_poses, 20_000)
        args.voxel_draws = min(args.voxel_draws, 1_000_000)
    if not np.allclose(space.metadata.get("X_FT", np.eye(4)), np.eye(4)):
        raise ReachabilityError(f"{args.file} is about a tool; only flange poses are compared here")
    rng = np.random.default_rng(args.seed)
    X = random_poses(rng, args.poses)
    reachable = exact(X)
    out: Path = args.out
    out.mkdir(parents=True, exist_ok=True)
    scores, verdicts = dict[str, Array](), dict[str, Mask]()
    for name in tqdm(LABELS, desc="judges"):
        # A finished judge is kept: the same command goes on where it was interrupted.
        sizes = (args.poses, args.peer_poses, args.paper_poses, args.voxel_draws)
        key = "-".join(map(str, (name, args.seed, *sizes)))
        file = out / "judges" / f"{key}.npz"
        stored = finished_arrays(file) if name != "rmm" else None
        if stored is not None:
            score, threshold = stored["score"], float(stored["threshold"])
        else:
            score, threshold = _score(name, X, space, args)
            if name != "rmm":
                write_arrays(file, {"score": score, "threshold": threshold}, compressed=False)
        scores[name] = score
        # A count of zero in the voxel map is no evidence of reach.
        verdicts[name] = (score >= threshold) & ((score > 0.0) | (name != "voxel"))
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
    X = se3.random_pose(rng, n)
    X[:, :3, 3] = rng.uniform(LOWEST, HIGHEST, (n, 3))
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
    score: Callable[[Array], Array]
    if name == "voxel":
        score = VoxelMap(_reached(rng, args.voxel_draws, thin=False)).score
        held_out = _reached(rng, args.peer_poses, thin=False)
    elif name == "rmm-paper":
        blocks = _reached_blocks(rng, args.paper_poses)
        fit = LargeFit(threads=args.jobs)
        mixture, _ = fit_large_mixture(blocks, PAPER_COMPONENTS, rng, fit)
        score = partial(log_densities, packed=pack(mixture))
        held_out = _reached(rng, args.peer_poses, thin=False)
    else:
        known = _reached(rng, 4 * args.peer_poses, thin=not name.endswith("paper"))
        held_out, known = np.split(known[: args.peer_poses], [args.peer_poses // 5])
        score = FlatMixture.fit(known, len(space.mixture), rng).log_density
    return score(X), float(np.quantile(score(held_out), 0.01))


def _reached_blocks(rng: np.random.Generator, count: int) -> PoseBlocks:
    """So many reached flange poses of uniform draws, packed as they come: millions fit."""
    arm, quaternions, positions, there = IiwaArm(), [], [], 0
    while there < count:
        part = sample_reachable_poses(arm, 250_000, rng)
        quaternions.append(part.quaternions)
        positions.append(part.positions)
        there += len(part.positions)
    return PoseBlocks.of(np.concatenate(quaternions)[:count], np.concatenate(positions)[:count])


def _reached(rng: np.random.Generator, draws: int, thin: bool) -> Array:
    """Reached flange poses, shape (n, 4, 4)."""
    arm, parts = IiwaArm(), []
    reference = manipulability_reference(arm) if thin else None
    for start in range(0, draws, 250_000):
        part = sample_reachable_poses(arm, min(250_000, draws - start), rng, thin=reference)
        parts.append(se3.make_pose(se3.rotations(part.quaternions), part.positions))
    return np.concatenate(parts)


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
