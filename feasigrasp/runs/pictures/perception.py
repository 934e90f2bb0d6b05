"""Picture of a perception result: cloud, completed surface and grasps."""

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from pydrake.geometry import Rgba
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.perception import BaseField, Fields, PointCloud

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.geometry.se3 import make_pose, perpendiculars
from feasigrasp.models.grasps.glyphs import (
    disc,
    frames_along,
    gripper_glyph,
    place_copies,
    spread_order,
)
from feasigrasp.models.grasps.perceive import Perception
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.shape.gpdf import Gpdf, SurfacePoints
from feasigrasp.outputs import save_figure
from feasigrasp.runs.pictures.splats import (
    Viewer,
    draw_axes,
    draw_lines,
    draw_points,
    frame,
    scale_bar,
)
from feasigrasp.runs.replay import quiet_meshcat, write_html
from feasigrasp.systems.monitoring.meshcat_view import distance_from_seen, set_background


@lru_cache(maxsize=1)
def dense_surface(gpdf: Gpdf, across: int = 90) -> SurfacePoints:
    """Points of the completed surface, evenly spread, with normals.

    `Gpdf.surface` projects a grid, which leaves holes where the field fans out. Here each of its
    points sends neighbours along its tangent plane, which are projected again, until the surface is
    covered; ``across`` points are along the longest side of the measured cloud.
    """
    spacing = float(np.ptp(gpdf.bounds, axis=0).max()) / across
    grown = gpdf.surface(16)  # first, uneven sample from a grid of 16 points per side
    first = _one_per_voxel(grown.points, spacing)
    points, normals = new, new_normals = grown.points[first], grown.normals[first]
    for _ in range(5):  # times that the sample grows by the neighbours of what was new
        tangents = perpendiculars(new_normals)
        beside = [new + spacing * sign * t for t in tangents for sign in (1.5, -1.5)]
        _, ends, end_normals = gpdf.refine(np.concatenate(beside), steps=4)
        kept = np.abs(gpdf.distance(ends)) < 5e-4  # on the surface, by the raw distance [m]
        all_points = np.concatenate([points, ends[kept]])
        all_normals = np.concatenate([normals, end_normals[kept]])
        first = _one_per_voxel(all_points, spacing)
        added = first[first >= len(points)]
        points, normals = all_points[first], all_normals[first]
        new, new_normals = all_points[added], all_normals[added]
    return SurfacePoints(points, normals)


def _one_per_voxel(points: Array, size: float) -> Indices:
    """Indices of the first point of every voxel."""
    return np.unique(np.floor(points / size).astype(np.int64), axis=0, return_index=True)[1]


#: Everything is drawn below this Meshcat path; its children can be switched off by hand.
_ROOT = "/perception"
GRASP_COLOR = "#10a040"


def write_perception_html(perception: Perception, filename: Path) -> None:
    """Writes cloud, completed surface (colored by uncertainty) and grasps as an HTML file.

    The object stands upright with its middle in the origin; the measured points are under
    ``/perception/cloud``, the surface under ``completion``, the grasps under ``grasps``, and the
    table, if one was found, under ``table``.
    """
    meshcat = quiet_meshcat()
    # Meshcat's up is z.
    R = RotationMatrix.MakeFromOneVector(upward(perception), 2).inverse()
    middle = perception.gpdf.completion.points.mean(axis=0)
    meshcat.SetTransform(_ROOT, RigidTransform(R, -(R @ middle)))

    points = perception.cloud.points
    cloud = PointCloud(len(points), Fields(BaseField.kXYZs | BaseField.kRGBs))
    cloud.mutable_xyzs()[:] = points.T
    cloud.mutable_rgbs()[:] = np.array([[40], [50], [65]], dtype=np.uint8)
    meshcat.SetObject(f"{_ROOT}/cloud", cloud, point_size=0.0015)

    surface = dense_surface(perception.gpdf)
    vertices, faces = disc(0.0022)  # radius of the discs that stand for the surface [m]
    colors = np.repeat(uncertainty_colors(perception.gpdf, surface), len(vertices), axis=0)
    frames = frames_along(surface.points, surface.normals)
    vertices, faces = place_copies(frames, vertices, faces)
    meshcat.SetTriangleColorMesh(f"{_ROOT}/completion", vertices.T, faces.T, colors.T)

    X_OG = shown_grasps(perception)
    if len(X_OG) > 0:
        vertices, faces = place_copies(X_OG, *gripper_glyph(perception.gripper))
        meshcat.SetTriangleMesh(f"{_ROOT}/grasps", vertices.T, faces.T, Rgba(*to_rgb(GRASP_COLOR)))

    for k, line in enumerate(table_lines(perception)):
        meshcat.SetLine(f"{_ROOT}/table/{k}", line.T, 2.0, Rgba(0.5, 0.45, 0.4))
    set_background(meshcat)
    towards = R @ towards_viewer(perception)
    size = float(np.ptp(surface.points, axis=0).max())
    place = 2.2 * size * (towards / np.linalg.norm(towards) + np.array([0.0, 0.0, 0.15]))
    meshcat.SetCameraPose(place, np.zeros(3))
    write_html(meshcat, filename)


#: From surface that was seen to surface that was made up.
UNCERTAINTY_COLORS = LinearSegmentedColormap.from_list(
    "uncertainty", ["#1f6fe0", "#7d5fd3", "#d6409f", "#ff8a3c", "#ffd23f"]
)
#: Distance from the observed surface at which the colors end [m]. Source: layout.
MOST_UNCERTAIN = 0.03


def upward(perception: Perception) -> Array:
    """Up direction: away from the table; -y in a camera's own frame (origin in the camera); z."""
    if perception.gpdf.table is not None:
        return perception.gpdf.table[:3]
    return np.array([0.0, -1.0, 0.0] if in_camera(perception) else [0.0, 0.0, 1.0])


def in_camera(perception: Perception) -> bool:
    """Whether everything is in the camera's own frame."""
    return perception.viewpoint is not None and not perception.viewpoint.any()


def towards_viewer(perception: Perception) -> Array:
    """Direction from the object to where the pictures are taken from."""
    if perception.viewpoint is None:
        return np.array([1.0, -1.0, 0.7])
    return perception.viewpoint - perception.cloud.points.mean(axis=0)


def uncertainty_colors(gpdf: Gpdf, surface: SurfacePoints) -> Array:
    """Colors of completed points by uncertainty, shape (n, 3)."""
    share = distance_from_seen(gpdf, surface.points) / MOST_UNCERTAIN
    return np.asarray(UNCERTAINTY_COLORS(np.clip(share, 0.0, 1.0)))[:, :3]


def shown_grasps(perception: Perception) -> Array:
    """The best grasp and 11 others unlike it at most, shape (k, 4, 4)."""
    grasps = perception.grasps
    return grasps.X_OG[spread_order(grasps.X_OG, grasps.score)[:12]]


def table_lines(perception: Perception) -> Array:
    """A grid on the table under the object, shape (k, 2, 3) [m]; empty without a table."""
    plane, points = perception.gpdf.table, perception.gpdf.completion.points
    if plane is None or len(points) == 0:
        return np.zeros((0, 2, 3))
    middle = points.mean(axis=0)
    middle = middle - (middle @ plane[:3] + plane[3]) * plane[:3]
    half = 0.8 * float(np.ptp(points, axis=0).max())
    x, y = perpendiculars(plane[:3])
    return np.array(
        [
            middle + half * np.array([share * a - b, share * a + b])
            for a, b in ((x, y), (y, x))
            for share in np.linspace(-1.0, 1.0, 7)
        ]
    )


def gripper_outline(gripper: Gripper) -> Array:
    """The open hand as one line in frame G, from the wrist over both fingers, shape (7, 3) [m]."""
    x, tip, heel = gripper.max_opening / 2, gripper.tip, gripper.heel
    wrist = heel - 0.5 * (tip - heel)
    line = [(0, wrist), (0, heel), (-x, heel), (-x, tip), (-x, heel), (x, heel), (x, tip)]
    return np.array([(a, 0.0, b) for a, b in line])


def draw_perception(perception: Perception, filename: Path, title: str = "") -> None:
    """Draws the cloud, the completed surface from both sides, and the grasps, as a PNG.

    With the cloud come the axes of its frame, with the grasps those of the best one.
    """
    dot = 5.5  # diameter of the dots of a surface [points], wide enough to close it
    figure = Figure(figsize=(14.0, 4.6))
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 4)
    figure.subplots_adjust(left=0.005, right=0.995, top=0.87, bottom=0.13, wspace=0.02)
    towards, up = towards_viewer(perception), upward(perception)
    front = Viewer.at(towards, up, turn=0.4, raised=0.2)
    behind = Viewer.at(towards, up, turn=np.pi + 0.4, raised=0.2)
    gpdf, surface = perception.gpdf, dense_surface(perception.gpdf)
    colors = uncertainty_colors(gpdf, surface)
    everything = np.concatenate([surface.points, perception.cloud.points])

    count = len(perception.cloud.points)
    draw_points(axes[0], front, perception.cloud.points, (0.25, 0.3, 0.38), size=1.8)
    size = 0.25 * float(np.ptp(everything, axis=0).max())
    X = make_pose(np.eye(3), everything.mean(axis=0))
    draw_axes(axes[0], front, X, size)
    whose = "camera" if in_camera(perception) else "cloud"
    axes[0].set_title(f"measured: {count} points; axes of the {whose}", fontsize=10)
    given: dict[str, Any] = {"size": dot, "normals": surface.normals}
    for ax, viewer, side in ((axes[1], front, "camera's side"), (axes[2], behind, "from behind")):
        draw_points(ax, viewer, surface.points, colors, **given)
        ax.set_title(f"completed, {side}")
    table = table_lines(perception)
    for ax, viewer in zip(axes, (front, front, behind, front), strict=True):
        draw_lines(ax, viewer, table, "#8a7a68", alpha=0.5, order=0)
        frame(ax, viewer, everything)

    draw_points(axes[3], front, surface.points, (0.72, 0.74, 0.78), **given)
    X_OG, hand = shown_grasps(perception), gripper_outline(perception.gripper)
    lines = np.einsum("nij,kj->nki", X_OG[:, :3, :3], hand) + X_OG[:, None, :3, 3]
    draw_lines(axes[3], front, lines, GRASP_COLOR, alpha=0.8)
    for X in X_OG[:1]:
        draw_axes(axes[3], front, X, size)
    shown = f"{len(perception.grasps)} grasps, {len(X_OG)} shown; x closes, z approaches"
    axes[3].set_title(shown, fontsize=10)
    frame(axes[3], front, np.concatenate([everything, lines.reshape(-1, 3)]))
    for ax in axes:
        scale_bar(ax)

    scale = ScalarMappable(Normalize(0.0, 1e3 * MOST_UNCERTAIN), UNCERTAINTY_COLORS)
    place = figure.add_axes((0.375, 0.075, 0.25, 0.022))
    bar = figure.colorbar(scale, cax=place, orientation="horizontal")
    bar.set_label("uncertainty: distance from the observed surface [mm]", fontsize=8, labelpad=1)
    bar.ax.tick_params(labelsize=7, pad=1)
    figure.suptitle(title, y=0.985, fontsize=12)
    save_figure(figure, filename, dpi=100)
