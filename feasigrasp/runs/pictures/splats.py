"""Software renderer for points with normals, by splatting with back-face culling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3 import perpendiculars


@dataclass(frozen=True)
class Viewer:
    """A parallel projection: unit vectors (3,) to the right, up, and back to the viewer."""

    right: Array
    up: Array
    back: Array

    @classmethod
    def at(
        cls, towards_viewer: ArrayLike, up: ArrayLike, *, turn: float = 0.0, raised: float = 0.0
    ) -> Viewer:
        """A viewer in a direction (3,) from the scene, with what is ``up`` (3,).

        It then walks round the scene by the angle ``turn``, and climbs by ``raised`` [rad].
        """
        back: Array = np.array(towards_viewer, dtype=float)
        z: Array = np.array(up, dtype=float)
        z /= np.linalg.norm(z)
        level = back - (back @ z) * z
        climb = np.arctan2(back @ z, np.linalg.norm(level)) + raised
        if np.linalg.norm(level) < 1e-6 * np.linalg.norm(back):  # straight from above
            level = -perpendiculars(z)[1]
        climb = np.clip(climb, -1.55, 1.55)
        level = level / np.linalg.norm(level)
        level = np.cos(turn) * level + np.sin(turn) * np.cross(z, level)
        back = np.cos(climb) * level + np.sin(climb) * z
        right = np.cross(z, back)
        right = right / np.linalg.norm(right)
        return cls(right, np.cross(back, right), back)

    def project(self, points: ArrayLike) -> Array:
        """Picture coordinates and height towards the viewer, shape (..., 3)."""
        return np.asarray(points, dtype=float) @ np.stack([self.right, self.up, self.back], axis=1)


def draw_points(
    ax: Axes,
    viewer: Viewer,
    points: ArrayLike,
    colors: ArrayLike,
    *,
    size: float,
    normals: ArrayLike | None = None,
) -> None:
    """Draws points (n, 3) [m] as dots of a diameter [points], the nearest on top; see `frame`.

    Colors are red, green, blue, shape (n, 3) or (3,). Outward normals (n, 3) shade the dots, and
    hide those that face away.
    """
    x: Array = np.array(points, dtype=float).reshape(-1, 3)
    rgb: Array = np.broadcast_to(np.asarray(colors, dtype=float), x.shape)
    if normals is not None:
        seen_normals = viewer.project(normals)
        facing = seen_normals[:, 2] > 0.0
        # Direction of the light from the viewer's place: from above, on the left.
        shade = 0.55 + 0.45 * np.clip(seen_normals @ np.array([-0.35, 0.55, 0.76]), 0.0, 1.0)
        x, rgb = x[facing], (rgb * shade[:, None])[facing]
    seen = viewer.project(x)
    order = np.argsort(seen[:, 2])
    dots = seen[order]
    ax.scatter(dots[:, 0], dots[:, 1], s=size**2, c=rgb[order], linewidths=0, zorder=2)


def draw_lines(
    ax: Axes,
    viewer: Viewer,
    lines: ArrayLike,
    color: str,
    *,
    width: float = 1.2,
    alpha: float = 1.0,
    order: int = 3,
) -> None:
    """Draws polylines, shape (n, k, 3) [m], in one color."""
    seen = list(viewer.project(lines)[..., :2])
    ax.add_collection(LineCollection(seen, color=color, lw=width, alpha=alpha, zorder=order))


def draw_axes(ax: Axes, viewer: Viewer, X: ArrayLike, length: float) -> None:
    """Draws the axes of a pose (4, 4), so long [m]: x red, y green, z blue, with their letters."""
    pose = np.asarray(X, dtype=float)
    for k, color in enumerate(("#d02020", "#208020", "#2050d0")):
        ends = pose[:3, 3] + np.outer([0.0, length, 1.25 * length], pose[:3, k])
        draw_lines(ax, viewer, ends[None, :2], color, width=2.0, order=5)
        x, y, _ = viewer.project(ends[2])
        ax.text(x, y, "xyz"[k], color=color, ha="center", va="center")


def frame(ax: Axes, viewer: Viewer, points: ArrayLike) -> None:
    """Fits the picture to points (n, 3), with equal scales, a margin of 8 %, and without axes."""
    seen = viewer.project(points)[:, :2]
    middle, half = (seen.min(axis=0) + seen.max(axis=0)) / 2, np.ptp(seen, axis=0).max() / 2
    half *= 1.08
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)
    ax.set_aspect("equal")
    ax.axis("off")


def scale_bar(ax: Axes) -> None:
    """Draws a bar of 5 cm into the lower left corner."""
    x, y = ax.get_xlim(), ax.get_ylim()
    left, low = x[0] + 0.04 * (x[1] - x[0]), y[0] + 0.04 * (y[1] - y[0])
    ax.plot([left, left + 0.05], [low, low], color="0.3", lw=2, solid_capstyle="butt", zorder=4)
    ax.text(left, low + 0.015 * (y[1] - y[0]), "5 cm", color="0.3", fontsize=8, zorder=4)
