"""``feasigrasp evaluate shape-figures``: draw the distance field of completed objects.

Two pictures as in Choi & Figueroa (arXiv 2311.02576): the distance along a line through an object,
before and after refinement, beside the true one; and the completed surface coloured by its
uncertainty, from the camera's side and from behind.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from feasigrasp.models.arrays import Array
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.shape.completion import Preset, complete_shape
from feasigrasp.models.shape.gpdf_fit import Gpdf
from feasigrasp.outputs import save_figure
from feasigrasp.runs.pictures.dense_surface import dense_surface
from feasigrasp.runs.pictures.perception import (
    DOT,
    MOST_UNCERTAIN,
    UNCERTAINTY_COLORS,
    add_scale,
    two_rows,
    uncertainty_colors,
)
from feasigrasp.runs.pictures.splats import Viewer, draw_points, frame
from feasigrasp.runs.results.arguments import add_common_arguments, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp_lab.training.data.views import PartialView, ViewedObject, fused, look_at

#: Objects of the pictures unless others are asked for; the first one is cut by the line.
OBJECTS = "spray_can,mug,drill"
#: Directions from the object to the cameras, the first one is that of the single view.
_DIRECTIONS = ((1.0, -0.5, 0.6), (-0.9, -0.6, 0.5), (0.0, 1.0, 0.4))
#: Panels of the cut: the preset of the field, and how many views it is fitted to.
SLICES = {
    "paper, 1 view": ("paper", 1),
    "default, 1 view": ("default", 1),
    "default, 3 views": ("default", 3),
}
#: Distance from the object to the cameras [m].
_DISTANCE = 0.5
#: The line reaches this far beyond the object [m].
_BEYOND = 0.06
_STEPS = 10


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command."""
    add_common_arguments(parser, out="out/shape_figures", objects=OBJECTS)


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    objects = [
        (name, ViewedObject(load_object(model)))
        for name, model in list(select_objects(args.objects).items())[: 1 if args.quick else 3]
    ]
    args.out.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(args.seed)
    views = {name: look_round(viewed, rng) for name, viewed in objects}
    name, viewed = objects[0]
    slices = {
        title: slice_through(viewed, fit_views(views[name][:count], preset), views[name][0])
        for title, (preset, count) in SLICES.items()
    }
    write_csv(
        args.out / "slice.csv",
        [
            (preset, *(f"{value:.6f}" for value in values))
            for preset, curve in slices.items()
            for values in zip(*(curve[k] for k in ("x", "true", "raw", "refined")), strict=True)
        ],
        ("preset", "x_m", "true_m", "raw_m", "refined_m"),
    )
    draw_slices(slices, name, args.out / "slice.png")
    fields = {name: fit_views(views[name][:1]) for name, _ in objects}
    draw_uncertainty(fields, args.out / "uncertainty.png")
    report_rows(args, "evaluate shape-figures", slice_rows(slices))
    return 0


def look_round(viewed: ViewedObject, rng: np.random.Generator) -> list[PartialView]:
    """Noisy views from the cameras of the pictures."""
    directions = np.array(_DIRECTIONS)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return [viewed.view(look_at(_DISTANCE * d), rng) for d in directions]


def fit_views(views: Sequence[PartialView], preset: str = "default") -> Gpdf:
    """The field of some views, merged."""
    return complete_shape(fused(views, smooth=preset == Preset.DEFAULT), preset=preset)


def slice_through(viewed: ViewedObject, field: Gpdf, view: PartialView) -> dict[str, Array]:
    """Distances along the line from a camera through the middle of the observed surface.

    Returns:
        By name, over the same points: ``x`` along the line from the object's origin, negative on
        the camera's side, ``true``, ``raw`` and ``refined`` signed distance; all shape (n,) [m].
    """
    away = -view.p_OC / np.linalg.norm(view.p_OC)
    # Through an observed point, so that the line enters the object where it was seen.
    offset = view.points - (view.points @ away)[:, None] * away
    middle = offset[np.argmin(np.linalg.norm(offset - offset.mean(axis=0), axis=1))]
    along = (viewed.obj.vertices - middle) @ away
    x = np.linspace(along.min() - _BEYOND, along.max() + _BEYOND, 241)
    points = middle + x[:, None] * away
    return {
        "x": x,
        "true": viewed.surface.signed_distance(points),
        "raw": field.distance(points),
        "refined": field.refine(points, _STEPS)[0],
    }


def slice_rows(slices: dict[str, dict[str, Array]]) -> list[Row]:
    """Mean errors of raw and refined distance on the camera's side and behind the object."""
    rows = []
    for preset, curve in slices.items():
        outside = curve["true"] > 0.0
        entry, leave = curve["x"][~outside].min(), curve["x"][~outside].max()
        sides = {"before": curve["x"] < entry, "inside": ~outside, "behind": curve["x"] > leave}
        for kind in ("raw", "refined"):
            error = 1e3 * np.abs(curve[kind] - curve["true"])
            for side, chosen in sides.items():
                name = f"shape_figures.slice_{kind}_error_mm.{side}"
                count = int(chosen.sum())
                rows.append(Row.plain(name, preset, error[chosen].mean(), "mm", count))
    return rows


def draw_slices(slices: dict[str, dict[str, Array]], name: str, filename: Path) -> None:
    """Draws the curves, one panel per field; inside is grey."""
    figure = Figure(figsize=(11.5, 3.5), layout="constrained")
    axes = figure.subplots(1, len(slices), sharey=True, squeeze=False)[0]
    for ax, (preset, curve) in zip(axes, slices.items(), strict=True):
        x = 1e3 * curve["x"]
        solid = curve["true"] <= 0.0
        ax.fill_between(
            x, 0, 1, where=solid, color="0.9", lw=0, transform=ax.get_xaxis_transform(), zorder=0
        )
        ax.axhline(0.0, color="0.5", lw=0.7)
        ax.plot(x, 1e3 * curve["true"], color="0.1", lw=2.2, label="true distance")
        ax.plot(x, 1e3 * curve["raw"], color="#c2571a", lw=1.4, ls="--", label="before refinement")
        ax.plot(x, 1e3 * curve["refined"], color="#1f5fa8", lw=1.6, label="after refinement")
        ax.set_title(f"{name}, {preset}", fontsize=10)
        ax.set_xlabel("along the line of sight [mm]")
        ax.grid(alpha=0.25)
        ax.text(0.02, 0.03, "← camera", transform=ax.transAxes, fontsize=8, color="0.35")
    axes[0].set_ylabel("signed distance [mm]")
    axes[0].legend(frameon=False, fontsize=9)
    save_figure(figure, filename, dpi=110)


def draw_uncertainty(fields: dict[str, Gpdf], filename: Path) -> None:
    """Draws the completed surfaces of single views, the camera's side above, behind below."""
    sides = ("camera's side", "from behind")
    figure, axes = two_rows(list(fields), sides)
    camera = np.array(_DIRECTIONS[0])
    for column, field in enumerate(fields.values()):
        surface = dense_surface(field)
        colors = uncertainty_colors(field, surface)
        for ax, turn in zip(axes[:, column], (0.3, np.pi + 0.3), strict=True):
            viewer = Viewer.at(camera, [0.0, 0.0, 1.0], turn=turn)
            draw_points(ax, viewer, surface.points, colors, size=DOT, normals=surface.normals)
            frame(ax, viewer, surface.points)
    label = "uncertainty: distance from the observed surface [mm]"
    add_scale(figure, UNCERTAINTY_COLORS, 1e3 * MOST_UNCERTAIN, label)
    save_figure(figure, filename, dpi=90)
