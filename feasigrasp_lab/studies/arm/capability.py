"""``feasigrasp evaluate capability``: draw the workspace of the arm, in slices and in 3-D.

At every point of a slice, the same set of random orientations of the flange is tried: the share
that exact inverse kinematics reaches, the share that the reachable-space mixture takes for
reachable, and the mixture's mean density over them.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

from feasigrasp.models.geometry import se3
from feasigrasp.runs.results.arguments import add_common_arguments, positive
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.paper.reachable_space import ReachableSpace
from feasigrasp_lab.pictures.capability import Slice, plot_slices, write_scene
from feasigrasp_lab.studies.arm.reachability import exact

#: The arm in the pictures, in the plane of the vertical slice [rad].
POSTURE = np.deg2rad([0.0, 35.0, 0.0, -75.0, 0.0, 55.0, 0.0])
#: Height of the horizontal slice [m].
HEIGHT = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/capability", objects="builtin")
    parser.add_argument(
        "--file", type=Path, help="Reachable space, an npz file. Default: the packaged one."
    )
    parser.add_argument(
        "--orientations",
        type=positive,
        default=96,
        help="Number of orientations of the flange per point.",
    )
    parser.add_argument(
        "--spacing", type=float, default=0.04, help="Distance between points of a slice, in metres."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    if args.quick:
        args.orientations, args.spacing = min(args.orientations, 32), max(args.spacing, 0.08)
    space = ReachableSpace.load(args.file) if args.file else ReachableSpace.load_default()
    R = se3.random_pose(np.random.default_rng(args.seed), args.orientations)[:, :3, :3]
    args.out.mkdir(parents=True, exist_ok=True)
    across = np.arange(-1.0, 1.0 + 1e-9, args.spacing)
    up = np.arange(0.0, 1.36 + 1e-9, args.spacing)
    grids = {
        "vertical": (across, up, lambda a, b: (a, 0.0, b)),
        "horizontal": (across, across, lambda a, b: (a, b, HEIGHT)),
    }
    slices = {}
    for name, (a, b, place) in grids.items():
        points = np.array([[place(x, y) for x in a] for y in b])
        shares = _shares(points.reshape(-1, 3), R, space, name).reshape(len(b), len(a), 3)
        slices[name] = Slice(a, b, *np.moveaxis(shares, 2, 0))
        heads = ("x", "y", "z", "exact_share", "accepted_share", "mean_density")
        table = np.concatenate([points, shares], axis=2).reshape(-1, 6)
        write_csv(args.out / f"{name}.csv", table.tolist(), heads, ".6g")
    plot_slices(slices["vertical"], slices["horizontal"], HEIGHT, POSTURE, args.out / "slices.png")
    coarse = np.arange(-1.0, 1.0 + 1e-9, 2.5 * args.spacing)
    x, y, z = np.meshgrid(coarse, coarse, np.arange(0.0, 1.36, 2.5 * args.spacing), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    points = points[np.linalg.norm(points - [0.0, 0.0, 0.34], axis=1) < 1.0]
    share = _shares(points, R[: len(R) // 2], space, "3-D")[:, 0]
    write_scene(points, share, POSTURE, 2.5 * args.spacing, args.out / "capability.html")
    everywhere = np.concatenate([s.exact.ravel() for s in slices.values()])
    accepted = np.concatenate([s.accepted.ravel() for s in slices.values()])
    correlation = float(np.corrcoef(everywhere, accepted)[0, 1])
    name, n = "capability.share_correlation", len(everywhere)
    report_rows(args, "evaluate capability", [Row.plain(name, "default", correlation, "1", n)])
    return 0


def _shares(points: np.ndarray, R: np.ndarray, space: ReachableSpace, name: str) -> np.ndarray:
    """Per point: share reached, share taken for reachable, mean density; shape (n, 3)."""
    out = np.empty((len(points), 3))
    batch = 64
    for start in tqdm(range(0, len(points), batch), desc=name, unit="batch"):
        chunk = points[start : start + batch]
        X = se3.make_pose(np.tile(R, (len(chunk), 1, 1)), np.repeat(chunk, len(R), axis=0))
        log_density = space.log_density(X).reshape(len(chunk), -1)
        out[start : start + batch, 0] = exact(X).reshape(len(chunk), -1).mean(axis=1)
        out[start : start + batch, 1] = (log_density >= space.threshold).mean(axis=1)
        out[start : start + batch, 2] = np.exp(log_density).mean(axis=1)
    return out
