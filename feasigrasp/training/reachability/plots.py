"""Plots about the reachable space: the BIC curve and the ROC curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure
from numpy.typing import NDArray


def plot_bic(components: Sequence[int], bic: Sequence[float], filename: Path) -> None:
    """Draws the Bayesian information criterion over the number of components."""
    figure = Figure(figsize=(5.2, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.plot(components, [value / 1e6 for value in bic], "o-", color="#1f5fa8")
    axes.set_xscale("log", base=2)
    axes.set_xticks(components, [str(k) for k in components])
    axes.set_xlabel("components K")
    axes.set_ylabel("BIC / 10⁶  (lower is better)")
    axes.grid(alpha=0.3)
    figure.savefig(filename, dpi=150)


def plot_roc(
    curves: Mapping[str, tuple[NDArray, NDArray]],
    points: Mapping[str, tuple[float, float]],
    filename: Path,
) -> None:
    """Draws ROC curves.

    Args:
        curves: By label, the shares of false and of true positives.
        points: By label, one pair of shares to mark on that curve.
        filename: Where to.
    """
    figure = Figure(figsize=(5.2, 4.4), layout="constrained")
    axes = figure.subplots()
    for index, (label, (false, true)) in enumerate(curves.items()):
        axes.plot(false, true, label=label, color=f"C{index}")
        if label in points:
            axes.plot(*points[label], "o", color=f"C{index}")
    axes.plot([0, 1], [0, 1], ":", color="0.6")
    axes.set_xlabel("share of unreachable poses taken for reachable")
    axes.set_ylabel("share of reachable poses found")
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1.005)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(filename, dpi=150)
