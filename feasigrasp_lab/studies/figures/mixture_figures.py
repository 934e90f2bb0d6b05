"""``feasigrasp evaluate mixture-figures``: draw a mixture of grasps, and a hand's ascent on it.

The paper's figure 6 (Choi & Figueroa, arXiv 2311.02576) from our own grasps: what the sampler
proposes and the filter leaves in grey, the means of a mixture with four components in red, and in
green the way of a hand up its log density. Beside it the same with the medoids, the grasps that
stand for the components, in place of the means; the mesh decides which of either are valid.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.mixtures.fit import fit_riemannian_mixture
from feasigrasp.models.mixtures.mixture import RiemannianMixture
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import SurfacePoints
from feasigrasp.outputs import save_figure
from feasigrasp.runs.pictures.dense_surface import dense_surface
from feasigrasp.runs.pictures.perception import DOT, gripper_outline, outlines_at
from feasigrasp.runs.pictures.splats import Viewer, draw_lines, draw_points, frame, scale_bar
from feasigrasp.runs.results.arguments import add_common_arguments, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.paper.ascent import ascent_direction
from feasigrasp_lab.training.data.grasp_examples import fuse_and_complete
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.views import ViewedObject, look_at

#: Directions from the object to the cameras of its three views, and their distance [m].
_DIRECTIONS, _DISTANCE = ((1.0, -0.6, 0.7), (-0.6, 1.0, 0.6), (-0.6, -0.8, 0.9)), 0.5
#: Where the hand starts: from the object's middle [m], its approach direction towards that.
_START = np.array([0.17, -0.15, 0.21])
#: Share of the preconditioned direction that is taken at a time, and how often.
_STEP, _STEPS = 0.03, 300
_GREY, _RED, _GREEN = "0.62", "#c8201e", "#0c8a3c"
_SURFACE = (0.80, 0.83, 0.88)


@dataclass(frozen=True, eq=False)
class Climb:
    """A hand on its way up a mixture.

    Attributes:
        targets: The maxima that it is drawn to, shape (K, 4, 4).
        valid: Which of them are truly grasps, shape (K,).
        poses: Of the hand, from its start on, shape (n, 4, 4).
        log_density: Of the mixture at these poses, shape (n,).
        end_valid: Whether the last one is truly a grasp.
    """

    targets: Array
    valid: Mask
    poses: Array
    log_density: Array
    end_valid: bool


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command."""
    add_common_arguments(parser, out="out/mixture_figures", objects="mug")
    parser.add_argument(
        "--components", type=int, default=4, help="Number of components of the mixture."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the command; of several objects the first one is drawn."""
    model = next(iter(select_objects(args.objects).values()))
    viewed, rng = ViewedObject(load_object(model)), np.random.default_rng(args.seed)
    directions = np.array(_DIRECTIONS)[: 1 if args.quick else 3]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    field = fuse_and_complete([viewed.view(look_at(_DISTANCE * d), rng) for d in directions])
    sampler = NetworkSampler()
    grasps = sampler(field)
    if len(grasps) == 0:
        raise GraspError(f"no grasp of {model} was found; draw another object with --objects")
    mixture = fit_riemannian_mixture(grasps.X_OG, args.components, rng)
    medoids = grasps.X_OG[mixture.medoids(grasps.X_OG)]
    truth = TrueGrasps(viewed.obj.mesh)
    climbs = {
        what: climb(RiemannianMixture(mixture.weights, targets, mixture.covariances), truth)
        for what, targets in (("means", mixture.means), ("medoids", medoids))
    }
    draw(climbs, grasps.X_OG, dense_surface(field), args.out / "mixture.png")
    lines = [
        (what, step, *(f"{x:.5f}" for x in X[:3, 3]), f"{density:.4f}")
        for what, found in climbs.items()
        for step, (X, density) in enumerate(zip(found.poses, found.log_density, strict=True))
    ]
    write_csv(args.out / "climbs.csv", lines, ("to", "step", "x_m", "y_m", "z_m", "log_density"))
    report_rows(args, "evaluate mixture-figures", climb_rows(climbs))
    return 0


def climb(mixture: RiemannianMixture, truth: TrueGrasps) -> Climb:
    """Follows the preconditioned ascent direction of a mixture from the start of the picture."""
    poses = [start_pose()]
    for _ in range(_STEPS):
        poses.append(poses[-1] @ se3.exp(_STEP * ascent_direction(mixture, poses[-1])))
    X, gripper = np.array(poses), ParallelGripper()
    valid = truth.valid(np.concatenate([mixture.means, X[-1:]]), gripper)
    return Climb(mixture.means, valid[:-1], X, mixture.log_density(X), bool(valid[-1]))


def start_pose() -> Array:
    """The hand at its start, looking at the object's middle, shape (4, 4)."""
    z = -_START / np.linalg.norm(_START)
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    X = np.eye(4)
    X[:3, :3], X[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), _START
    return X


def climb_rows(climbs: dict[str, Climb]) -> list[Row]:
    """Which targets, and which ends of the climb, are grasps; how far up the climb leads."""
    rows = []
    for what, found in climbs.items():
        rows += [
            Row.percent("mixture_figures.valid_percent.target", what, found.valid),
            Row.percent("mixture_figures.valid_percent.end", what, [found.end_valid]),
            Row.plain(
                "mixture_figures.log_density_gain",
                what,
                found.log_density[-1] - found.log_density[0],
                "1",
                1,
            ),
        ]
    return rows


def draw(climbs: dict[str, Climb], X_OG: Array, surface: SurfacePoints, filename: Path) -> None:
    """Draws a panel for each kind of target."""
    figure = Figure(figsize=(5.0 * len(climbs), 5.2))
    axes = figure.subplots(1, len(climbs), squeeze=False)[0]
    figure.subplots_adjust(left=0.0, right=1.0, top=0.93, bottom=0.06, wspace=0.0)
    viewer = Viewer.at([1.0, -0.7, 0.5], [0.0, 0.0, 1.0], turn=0.25, raised=0.1)
    hand = gripper_outline(ParallelGripper())
    for ax, (what, found) in zip(axes, climbs.items(), strict=True):
        _draw_panel(ax, viewer, found, X_OG, surface, hand)
        ax.set_title(f"up to the {what} of {len(found.targets)} components", fontsize=11)
        verdict = f"{found.valid.sum()} of {len(found.valid)} {what} are truly grasps; "
        verdict += f"the hand ends {'in one' if found.end_valid else 'in none'}"
        ax.text(0.5, -0.01, verdict, transform=ax.transAxes, ha="center", va="top", fontsize=9)
    save_figure(figure, filename, dpi=100)


def _draw_panel(
    ax: Axes, viewer: Viewer, found: Climb, X_OG: Array, surface: SurfacePoints, hand: Array
) -> None:
    draw_points(ax, viewer, surface.points, _SURFACE, size=DOT, normals=surface.normals)
    draw_lines(ax, viewer, outlines_at(X_OG, hand), _GREY, width=0.6, alpha=0.55)
    draw_lines(ax, viewer, outlines_at(found.targets, hand), _RED, width=2.4)
    ends = found.poses[[0, -1]]
    draw_lines(ax, viewer, outlines_at(ends, hand), _GREEN, width=3.0)
    draw_lines(ax, viewer, found.poses[None, :, :3, 3], _GREEN, width=2.2)
    hands = (outlines_at(X, hand).reshape(-1, 3) for X in (X_OG, ends))
    shown = np.concatenate([surface.points, found.poses[:, :3, 3], *hands])
    frame(ax, viewer, shown, margin=0.03)
    scale_bar(ax)
