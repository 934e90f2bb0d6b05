"""``feasigrasp evaluate joint-field-figures``: draw the field over configurations of a small arm.

The paper's figure 7 (Choi & Figueroa, arXiv 2311.02576): an arm of two links in the plane, targets
of its end with the configurations that reach them, and the distance field over the two joints
whose descent leads to one of them, for several length scales. It is the field that
`GPJointController` descends (`feasigrasp.models.control.joint.field`), with all costs zero, and the
joints that this arm does not have left at zero. How many starts end in a configuration that reaches
a target is counted.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.control.joint.field import (
    NOISE_VARIANCE,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
    length_scale_kernel,
)
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.outputs import save_figure
from feasigrasp.runs.results.arguments import add_common_arguments
from feasigrasp.runs.results.rows import Row, report_rows, write_csv

#: Lengths of the two links [m].
LINKS = (0.5, 0.4)
#: Where the targets lie: on arcs of these radii [m], at these angles [deg].
_RADII, _ANGLES = (0.5, 0.62, 0.74), (0.0, 30.0, 60.0, 90.0)
#: Length scales beside our own rule [rad]: the paper's, and one that is far too long.
_OTHERS = (0.3, 1.0)
#: Joint angles that are drawn, and where descents start [rad].
_RANGE = np.pi
#: A descent has arrived within so much of a solution [rad].
_ARRIVED = 0.02
#: Length of the steps of a descent [rad], and how many there are at most.
_STEP, _STEPS = 0.01, 1200
#: Ends that are no solution are crosses, at most so many.
_SHOWN = 60


@dataclass(frozen=True, eq=False)
class Field:
    """The distance field over the configurations of the small arm.

    Attributes:
        solutions: Configurations that it is fitted to, shape (n, 2) [rad].
        length_scale: Its length scale [rad].
        beta: Its weights, shape (n,).
    """

    solutions: Array
    length_scale: float
    beta: Array

    @classmethod
    def fit(cls, solutions: Array, length_scale: float | None = None) -> Field:
        """Fits the field; by the controller's rule for the length scale unless one is given."""
        r = np.zeros((len(solutions), len(solutions)))
        distances_kernel(_padded(solutions), r)
        scale = float(length_scale_kernel(r)) if length_scale is None else length_scale
        cost, lowest, beta = (np.zeros(len(solutions)) for _ in range(3))
        fit_kernel(r, cost, scale, NOISE_VARIANCE, lowest, beta)
        return cls(solutions, scale, beta)

    def evaluate(self, q: Array) -> tuple[Array, Array]:
        """Distance (m,) and its gradient (m, 2) at configurations (m, 2) [rad]."""
        nodes, lowest = _padded(self.solutions), np.zeros(len(self.solutions))
        distance, gradient = np.empty(len(q)), np.empty((len(q), IIWA_7.joints))
        weights = np.empty(len(nodes))
        for i, at in enumerate(_padded(q)):
            args = at, nodes, lowest, self.beta, self.length_scale, gradient[i], weights
            distance[i] = evaluate_kernel(*args)[0]
        return distance, gradient[:, :2]

    def descend(self, starts: Array) -> Array:
        """Where descents end that start at configurations (m, 2)."""
        q = starts.copy()
        for _ in range(_STEPS):
            distance, gradient = self.evaluate(q)
            steepness = np.maximum(np.linalg.norm(gradient, axis=1), 1e-9)
            q -= (np.clip(distance, -_STEP, _STEP) / steepness)[:, None] * gradient
        return q

    def arrived(self, q: Array) -> Mask:
        """Which of the configurations (m, 2) are a solution."""
        away = np.linalg.norm(q[:, None] - self.solutions, axis=-1)
        return np.asarray(away.min(axis=1) < _ARRIVED)


def _padded(q: Array) -> Array:
    """Configurations (n, 2) as those of an arm with more joints, which stay at zero."""
    return np.pad(q, ((0, 0), (0, IIWA_7.joints - 2)))


def forward(q: Array) -> Array:
    """Elbow and end of the small arm, shape (n, 2, 2) [m], at configurations (n, 2)."""
    angles = np.cumsum(q, axis=1)
    parts = np.array(LINKS)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    return np.cumsum(parts, axis=1)


def inverse(targets: Array) -> Array:
    """Both configurations, elbow right and left, for targets (n, 2) in reach; shape (2 n, 2)."""
    a, b = LINKS
    cosine = (np.sum(targets**2, axis=1) - a * a - b * b) / (2 * a * b)
    elbow = np.arccos(np.clip(cosine, -1.0, 1.0))
    found = []
    for q2 in (elbow, -elbow):
        towards = np.arctan2(targets[:, 1], targets[:, 0])
        q1 = towards - np.arctan2(b * np.sin(q2), a + b * np.cos(q2))
        found.append(np.stack([q1, q2], axis=1))
    return np.concatenate(found)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the command."""
    add_common_arguments(parser, out="out/joint_field_figures", objects="builtin")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    angles = np.deg2rad(_ANGLES)
    towards = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    targets = np.concatenate([radius * towards for radius in _RADII])
    solutions = inverse(targets)
    fields = [Field.fit(solutions, scale) for scale in (None, *_OTHERS)]
    rng = np.random.default_rng(args.seed)
    starts = rng.uniform(-_RANGE, _RANGE, (40 if args.quick else 400, 2))
    ends = [field.descend(starts) for field in fields]
    draw(fields, ends, targets, args.out / "joint_field.png")
    lines = [
        (f"{field.length_scale:.3f}", *(f"{x:.4f}" for x in (*start, *end)))
        for field, last in zip(fields, ends, strict=True)
        for start, end in zip(starts, last, strict=True)
    ]
    heads = ("length_scale_rad", "start_1", "start_2", "end_1", "end_2")
    write_csv(args.out / "descents.csv", lines, heads)
    presets = ("rule", *(f"l = {scale:g}" for scale in _OTHERS))
    name = "joint_field_figures.arrived_percent"
    rows = [
        Row.percent(name, preset, field.arrived(last))
        for preset, field, last in zip(presets, fields, ends, strict=True)
    ]
    scale = fields[0].length_scale
    rows += [Row.plain("joint_field_figures.length_scale_rad", presets[0], scale, "rad", 1)]
    report_rows(args, "evaluate joint-field-figures", rows)
    return 0


def draw(fields: list[Field], ends: list[Array], targets: Array, filename: Path) -> None:
    """Draws the arm at its targets, and a panel for each field."""
    figure = Figure(figsize=(3.6 * (1 + len(fields)), 3.9), layout="constrained")
    arm, *others = figure.subplots(1, 1 + len(fields))
    _draw_arm(arm, targets, fields[0].solutions)
    for ax, field, last in zip(others, fields, ends, strict=True):
        _draw_field(ax, field, last)
    others[0].set_ylabel("joint 2 [rad]")
    save_figure(figure, filename, dpi=100)


def _draw_arm(ax: Axes, targets: Array, solutions: Array) -> None:
    for joints, q in zip(forward(solutions), solutions, strict=True):
        line = np.concatenate([np.zeros((1, 2)), joints])
        color = "#1f5fa8" if q[1] > 0.0 else "#c2571a"
        ax.plot(*line.T, "o-", color=color, lw=2.0, ms=4, alpha=0.55)
    ax.plot(*targets.T, "o", color="#d11f1f", ms=8, zorder=3)
    ax.plot(0.0, 0.0, "ks", ms=8)
    ax.set_aspect("equal")
    ax.set_title(f"{len(targets)} targets, {len(solutions)} configurations", fontsize=10)
    ax.set_xlabel("[m]")


def _draw_field(ax: Axes, field: Field, ends: Array) -> None:
    axis = np.linspace(-_RANGE, _RANGE, 121)
    q = np.stack(np.meshgrid(axis, axis), axis=-1)
    distance, gradient = field.evaluate(q.reshape(-1, 2))
    levels = np.linspace(0.0, 3.0, 16)
    d = distance.reshape(q.shape[:2])
    ax.contourf(axis, axis, d, levels, cmap="Blues_r", extend="both")
    ax.contour(axis, axis, d, [0.0], colors="#d11f1f", linewidths=1.0)
    down = -gradient.reshape(q.shape)
    ax.streamplot(
        axis, axis, down[..., 0], down[..., 1], color="0.25", linewidth=0.6, arrowsize=0.7
    )
    stuck = ends[~field.arrived(ends)][:_SHOWN]
    ax.plot(*field.solutions.T, "o", color="#d11f1f", ms=5, zorder=4)
    ax.plot(*stuck.T, "x", color="black", ms=4, mew=1.2, zorder=5)
    share = 100.0 * field.arrived(ends).mean()
    ax.set_title(f"l = {field.length_scale:.2f} rad: {share:.0f} % arrive", fontsize=10)
    ax.set_xlabel("joint 1 [rad]")
    ax.set_xlim(-_RANGE, _RANGE)
    ax.set_ylim(-_RANGE, _RANGE)
    ax.set_aspect("equal")
