"""``feasigrasp evaluate grasp-targets``: count how many targets of grasp mixtures are grasps.

For every object a mixture is fitted to its grasps, and its means, medoids and the places where the
preconditioned ascent comes to rest, or the ascent along the gradient, are put through the grasp
filter on the object's whole surface.
A pose passes if it does with the width of any grasp of the set.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from operator import itemgetter

import numpy as np
import trimesh
from tqdm import tqdm

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.task.grasp_mixture import fit_grasp_mixture
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.filter import filter_grasps
from feasigrasp.models.mixtures.fit import fit_riemannian_mixture
from feasigrasp.models.objects.rigid_object import load_object
from feasigrasp.models.robot.gripper import ParallelGripper
from feasigrasp.models.shape.gpdf_fit import Gpdf, fit_gpdf
from feasigrasp.runs.results.arguments import add_common_arguments, select_objects
from feasigrasp.runs.results.rows import Row, report_rows, write_csv
from feasigrasp.runs.results.statistics import grouped, mean
from feasigrasp_lab.paper.ascent import ascent_direction
from feasigrasp_lab.runs.rollout import object_grasps

_STARTS = 32  # hand poses from which the ascent is followed
_STEPS = 300
#: Variances of the narrowest component there can be: a step that long along the gradient is safe.
_NARROWEST = np.square([0.05] * 3 + [0.005] * 3)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declares the options."""
    add_common_arguments(parser, out="out/grasp_targets", objects="builtin")
    parser.add_argument(
        "--components", type=int, default=4, help="Number of components of the plain mixture."
    )


def main(args: argparse.Namespace) -> int:
    """Runs the study."""
    objects = select_objects(args.objects)
    if args.quick:
        objects = dict(list(objects.items())[:4])
    parts = []
    for name, model in tqdm(objects.items(), unit="object"):
        parts += [(name, what, share) for what, share in _shares(model, args).items()]
    write_csv(args.out / "objects.csv", parts, ("object", "target", "valid_percent"))
    rows = []
    for what, group in grouped(parts, itemgetter(1)).items():
        average = mean([share for _, _, share in group], 0.0, 100.0)
        rows.append(Row.of("targets.valid_percent", what, average, "%"))
    report_rows(args, "evaluate grasp-targets", rows)
    return 0


def _shares(model: str, args: argparse.Namespace) -> dict[str, float]:
    """Percentage of targets of one object that are grasps, by kind; none without grasps."""
    rng = np.random.default_rng(args.seed)
    surface, _ = trimesh.sample.sample_surface(load_object(model).mesh, 512, seed=args.seed)
    field = fit_gpdf(np.asarray(surface))
    grasps = object_grasps(model, seed=args.seed)
    if len(grasps) == 0:
        return {}
    both = grasps.with_symmetric()
    plain = fit_riemannian_mixture(both.X_OG, args.components, rng)
    best = fit_grasp_mixture(both, 10, rng)
    X_OH = se3.random_pose(rng, _STARTS)
    X_OH[:, :3, 3] *= 0.15 / np.linalg.norm(X_OH[:, :3, 3], axis=1, keepdims=True)
    targets = {
        f"mean, K = {args.components}": plain.means,
        "mean, K by BIC": best.mixture.means,
        "ascent to means": _climb(X_OH, lambda X: 0.05 * ascent_direction(best.mixture, X)),
        "medoid": best.targets.means,
        "ascent to medoids": _climb(X_OH, lambda X: 0.05 * ascent_direction(best.targets, X)),
        "gradient to means": _climb(
            X_OH, lambda X: _NARROWEST * best.mixture.log_density_gradient(X)
        ),
    }
    return {what: _valid_percent(field, X, grasps.width) for what, X in targets.items()}


def _climb(X: Array, step: Callable[[Array], Array]) -> Array:
    for _ in range(_STEPS):
        X = X @ se3.exp(step(X))
    return X


def _valid_percent(field: Gpdf, X_OG: Array, widths: Array) -> float:
    """Share of poses that are a grasp with one of the widths."""
    gripper = ParallelGripper()
    tried = np.quantile(widths, np.linspace(0.0, 1.0, 12))
    valid = 0
    for X in X_OG:
        poses = np.tile(X, (len(tried), 1, 1))
        valid += len(filter_grasps(field, poses, tried, gripper, cosine_steps=(-0.8,))) > 0
    return 100.0 * valid / len(X_OG)
