"""Sheets of panels: two rows with their names at the side, a title per column, one colour scale."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.cm import ScalarMappable
from matplotlib.colors import Colormap, Normalize
from matplotlib.figure import Figure


def two_rows(titles: Sequence[str], sides: tuple[str, str]) -> tuple[Figure, Any]:
    """A figure and its axes, shape (2, columns).

    Args:
        titles: Of the columns, names of objects.
        sides: Names of the rows.
    """
    figure = Figure(figsize=(2.7 * len(titles), 6.3))
    axes = figure.subplots(2, len(titles), squeeze=False)
    figure.subplots_adjust(left=0.04, right=0.99, top=0.935, bottom=0.11, wspace=0.03, hspace=0.08)
    for ax, title in zip(axes[0], titles, strict=True):
        ax.set_title(title.replace("_", " "), fontsize=11)
    for height, side in zip((0.73, 0.31), sides, strict=True):
        figure.text(0.012, height, side, rotation=90, va="center", fontsize=11)
    return figure, axes


def add_scale(
    figure: Figure,
    colors: Colormap,
    most: float,
    label: str,
    place: tuple[float, float, float, float] = (0.3, 0.055, 0.4, 0.016),
) -> None:
    """A colour scale from 0 to ``most`` below the panels, at left, bottom, width and height."""
    scale = ScalarMappable(Normalize(0.0, most), colors)
    bar = figure.colorbar(scale, cax=figure.add_axes(place), orientation="horizontal")
    bar.set_label(label, fontsize=8, labelpad=1)
    bar.ax.tick_params(labelsize=7, pad=1)
