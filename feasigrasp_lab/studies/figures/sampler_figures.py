"""``feasigrasp evaluate sampler-figures``: draw grasps before and after the filter.

Each object is seen once by the noisy camera and completed. The upper row shows what the sampler
proposes, coloured by the network's probability; the lower row what the filter leaves, coloured by
the score. Grasps that are truly valid, by the mesh, are counted.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.grasps.glyphs import spread_order
from feasigrasp.models.grasps.network_sampler import NetworkSampler
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf import SurfacePoints
from feasigrasp.outputs import save_figure
from feasigrasp.runs.pictures.dense_surface import dense_surface
from feasigrasp.runs.pictures.perception import (
    DOT,
    add_scale,
    gripper_outline,
    outlines_at,
    two_rows,
)
from feasigrasp.runs.pictures.splats import Viewer, draw_lines, draw_points, frame
from feasigrasp.runs.results.arguments import add_common_arguments, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.training.data.grasp_examples import fuse_and_complete
from feasigrasp_lab.training.data.grasp_truth import TrueGrasps
from feasigrasp_lab.training.data.views import ViewedObject, look_at

#: Objects of the picture unless others are asked for.
OBJECTS = "mustard_bottle,mug,drill,banana,hammer,spray_can"
#: Direction from the objects to the camera, and its distance [m].
_DIRECTION, _DISTANCE = np.array([1.0, -0.6, 0.7]), 0.5
#: Grasps drawn per panel.
_SHOWN = 12
#: Before and after the filter.
STAGES = ("proposed", "filtered")
#: From unlikely to certain.
COLORS = LinearSegmentedColormap.from_list("score", ["#c43a31", "#e8a33d", "#4fae4e", "#0b6b3a"])
_SURFACE = (0.74, 0.77, 0.82)


@dataclass(frozen=True, eq=False)
class Panel:
    """What is drawn of one object.

    Attributes:
        name: Of the object.
        surface: The completed surface.
        stages: Grasps before and after the filter, by `STAGES`: their poses (n, 4, 4), their
            scores (n,), and which are truly valid (n,).
    """

    name: str
    surface: SurfacePoints
    stages: dict[str, tuple[Array, Array, Mask]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command."""
    add_common_arguments(parser, out="out/sampler_figures", objects=OBJECTS)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    selected = list(select_objects(args.objects).items())[: 2 if args.quick else 6]
    panels = [make_panel(name, model, args.seed) for name, model in selected]
    args.out.mkdir(parents=True, exist_ok=True)
    draw_grasps(panels, ParallelGripper(), args.out / "grasps.png")
    heads = ("object", "when", "score", "valid", "x_m", "y_m", "z_m")
    write_csv(
        args.out / "grasps.csv", [line for panel in panels for line in lines_of(panel)], heads
    )
    rows = [
        Row.plain(f"sampler_figures.valid_share.{when}", panel.name, valid.mean(), "1", len(valid))
        for panel in panels
        for when, (_, _, valid) in panel.stages.items()
        if len(valid)
    ]
    report_rows(args, "evaluate sampler-figures", rows)
    return 0


def make_panel(name: str, model: str, seed: int) -> Panel:
    """Looks at one object once and samples its grasps."""
    viewed, rng = ViewedObject(load_object(model)), np.random.default_rng(seed)
    view = viewed.view(look_at(_DISTANCE * _DIRECTION / np.linalg.norm(_DIRECTION)), rng)
    field, sampler = fuse_and_complete([view]), NetworkSampler()
    truth = TrueGrasps(viewed.obj.mesh)
    X_OG, _, prior = sampler.candidates(field)
    kept = sampler(field)
    stages = {
        when: (poses, scores, truth.valid(poses, sampler.gripper))
        for when, poses, scores in (
            (STAGES[0], X_OG, prior.prod(axis=1)),
            (STAGES[1], kept.X_OG, kept.score),
        )
    }
    return Panel(name, dense_surface(field), stages)


def draw_grasps(panels: list[Panel], gripper: ParallelGripper, filename: Path) -> None:
    """Draws all panels as one picture."""
    figure, axes = two_rows([panel.name for panel in panels], STAGES)
    viewer = Viewer.at(_DIRECTION, [0.0, 0.0, 1.0], turn=0.35, raised=0.1)
    hand = gripper_outline(gripper)
    for column, panel in enumerate(panels):
        proposed, filtered = (poses for poses, _, _ in panel.stages.values())
        reach = outlines_at(filtered if len(filtered) else proposed, hand)
        everything = np.concatenate([panel.surface.points, reach.reshape(-1, 3)])
        for ax, (poses, scores, valid) in zip(axes[:, column], panel.stages.values(), strict=True):
            _draw_panel(ax, viewer, panel.surface, poses, scores, hand)
            frame(ax, viewer, everything, margin=0.02)
            share = f"{valid.sum()} of {len(valid)} valid"
            ax.text(0.5, -0.01, share, transform=ax.transAxes, ha="center", va="top", fontsize=9)
    add_scale(figure, COLORS, 1.0, "estimated probability that the grasp is valid")
    save_figure(figure, filename, dpi=110)


def _draw_panel(
    ax: Axes, viewer: Viewer, surface: SurfacePoints, poses: Array, scores: Array, hand: Array
) -> None:
    draw_points(ax, viewer, surface.points, _SURFACE, size=DOT, normals=surface.normals)
    if len(poses) == 0:
        return
    order = spread_order(poses, scores)[:_SHOWN]
    order = order[np.argsort(scores[order])]  # the best on top
    lines = outlines_at(poses[order], hand)
    height = viewer.project(lines)[..., 2].mean(axis=1)
    order, lines = order[np.argsort(height)], lines[np.argsort(height)]
    draw_lines(ax, viewer, lines, COLORS(scores[order]), width=1.3, alpha=0.85)


def lines_of(panel: Panel) -> Iterator[tuple[object, ...]]:
    """Score, truth and position of every grasp, as lines of a table."""
    for when, (poses, scores, valid) in panel.stages.items():
        for X, score, good in zip(poses, scores, valid, strict=True):
            place = (f"{value:.5f}" for value in X[:3, 3])
            yield panel.name, when, f"{score:.4f}", int(good), *place
