"""Slices through the capability map of the arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from pydrake.geometry import (
    Box,
    Meshcat,
    MeshcatVisualizer,
    MeshcatVisualizerParams,
    Rgba,
    Role,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.parsing import LoadModelDirectives, Parser, ProcessModelDirectives
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from scipy.spatial import ConvexHull

from feasigrasp.models.arrays import Array
from feasigrasp.models.robot.capsule_kernels import link_poses_kernel
from feasigrasp.models.robot.capsules import capsule_model
from feasigrasp.outputs import save_figure
from feasigrasp.resources import model_path
from feasigrasp.runs.replay import quiet_meshcat, write_html
from feasigrasp.systems.station.meshcat_scene import set_stage

#: Shares are shown in so many steps, each a folder of its own that can be hidden.
STEPS = 5
#: Where the camera stands and what it looks at [m], and its zoom.
CAMERA, TARGET, ZOOM = (1.3, -2.4, 1.3), (0.0, 0.0, 0.5), 2.2


def write_scene(
    points: Array, share: Array, posture: Array, spacing: float, filename: Path
) -> None:
    """Writes the arm amid spheres whose colour and size say how much is reached there.

    Only the half y > 0 has spheres, so that one looks into it.

    Args:
        points: Places, shape (n, 3) [m].
        share: Share of orientations reached there, shape (n,).
        posture: Joint positions of the arm, shape (7,) [rad].
        spacing: Distance of neighbouring points [m].
        filename: Where to write the HTML.
    """
    meshcat = quiet_meshcat()
    _publish_arm(meshcat, posture)
    colours = colormaps["viridis"]
    for i, (point, value) in enumerate(zip(points, share, strict=True)):
        if value <= 0.02 or point[1] < 0.05:
            continue
        step = min(int(value * STEPS), STEPS - 1)
        red, green, blue, _ = colours(value)
        path = f"/reached/{20 * step:02d}-{20 * (step + 1)} percent/{i}"
        radius = 0.38 * spacing * (0.25 + 0.75 * np.sqrt(value))
        meshcat.SetObject(path, Sphere(radius), Rgba(red, green, blue, 1.0))
        meshcat.SetTransform(path, RigidTransform(point))
    meshcat.SetObject("/ground", Box(2.2, 2.2, 0.002), Rgba(0.86, 0.88, 0.9, 1.0))
    meshcat.SetTransform("/ground", RigidTransform([0.0, 0.0, -0.002]))
    set_stage(meshcat, CAMERA, TARGET, ZOOM)
    write_html(meshcat, filename)


def _publish_arm(meshcat: Meshcat, posture: Array) -> None:
    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    directives = LoadModelDirectives(str(model_path("iiwa", "cell.dmd.yaml")))
    ProcessModelDirectives(directives, plant, parser)
    plant.Finalize()
    params = MeshcatVisualizerParams(role=Role.kIllustration, prefix="/arm")
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat, params)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    arm = plant.GetModelInstanceByName("iiwa")
    plant.SetPositions(plant.GetMyMutableContextFromRoot(context), arm, posture)
    diagram.ForcedPublish(context)
    meshcat.Delete("/arm/table")


@dataclass(frozen=True, eq=False)
class Slice:
    """What is known at the points of a slice.

    Attributes:
        across: Coordinates along the horizontal axis of the picture, shape (a,) [m].
        up: Coordinates along the vertical axis, shape (b,) [m].
        exact: Share of orientations that exact inverse kinematics reaches, shape (b, a).
        accepted: Share that the mixture takes for reachable.
        density: Mean density of the mixture.
    """

    across: Array
    up: Array
    exact: Array
    accepted: Array
    density: Array


def plot_slices(
    vertical: Slice, horizontal: Slice, height: float, posture: Array, filename: Path
) -> None:
    """Draws both slices: exact share, accepted share and density beside each other.

    Args:
        vertical: The plane y = 0, x to the right and z up.
        horizontal: The plane z = ``height``, x to the right and y up.
        height: Height of the latter [m].
        posture: Joint positions of the arm that is drawn, shape (7,) [rad].
        filename: Where to.
    """
    heights = [np.ptp(vertical.up), np.ptp(horizontal.up)]
    figure = Figure(figsize=(10.0, 5.9), layout="compressed")
    axes = figure.subplots(2, 3, height_ratios=heights)
    densest = max(vertical.density.max(), horizontal.density.max())
    titles = (
        "orientations reached\n(exact inverse kinematics)",
        "orientations accepted\n(mixture at its 99 % threshold)",
        "mean density of the mixture\n(relative to the largest)",
    )
    for row, (piece, normal) in enumerate(((vertical, 1), (horizontal, 2))):
        for column, values in enumerate((piece.exact, piece.accepted, piece.density / densest)):
            ax = axes[row, column]
            image = ax.contourf(
                piece.across,
                piece.up,
                np.clip(values, 0.0, 1.0),
                np.linspace(0.0, 1.0, 26),
                cmap="magma" if column == 2 else "viridis",
            )
            levels = [0.02, 0.25, 0.5, 0.75]
            ax.contour(
                piece.across, piece.up, values, levels, colors="white", linewidths=0.6, alpha=0.6
            )
            _draw_arm(ax, posture, normal)
            ax.set_aspect("equal")
            ax.set_xlim(piece.across[[0, -1]])
            ax.set_ylim(piece.up[[0, -1]])
            ax.set_xlabel("x [m]")
            ax.set_ylabel("z [m]  at y = 0" if row == 0 else f"y [m]  at z = {height} m")
            if row == 0:
                ax.set_title(titles[column], fontsize=10)
    ticks = np.linspace(0.0, 1.0, 6)
    figure.colorbar(image, ax=axes[:, 2], shrink=0.7, ticks=ticks)
    first = axes[0, 0].collections[0]
    percent = "{x:.0%}"
    figure.colorbar(first, ax=axes[:, 1], shrink=0.7, ticks=ticks, format=percent)
    save_figure(figure, filename, dpi=95, bbox_inches="tight")


def _draw_arm(ax: Axes, posture: Array, normal: int) -> None:
    """Draws the arm's capsules, seen along an axis of the world (1: y, 2: z)."""
    model = capsule_model()
    R, p = np.empty((8, 3, 3)), np.empty((8, 3))
    link_poses_kernel(posture, R, p)
    shown = [0, 2] if normal == 1 else [0, 1]
    around = np.linspace(0.0, 2.0 * np.pi, 40)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    order = np.argsort(model.link, kind="stable")
    for c in order:
        link = model.link[c]
        ends = (model.ends[c] @ R[link].T + p[link])[:, shown]
        rim = (ends[:, None] + model.radius[c] * circle).reshape(-1, 2)
        corners = rim[ConvexHull(rim).vertices]
        outline = Outline(np.concatenate([corners, corners[:1]]), closed=True)
        patch = PathPatch(outline, facecolor="0.93", edgecolor="0.25", linewidth=0.7, alpha=0.75)
        ax.add_patch(patch)
