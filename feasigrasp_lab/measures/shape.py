"""What is measured on one completed shape; see `feasigrasp_lab.studies.shape`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import trimesh

from feasigrasp.models.arrays import Array, Mask
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.runs.results.statistics import area_under_curve
from feasigrasp_lab.measures.level_set import sample_level_set
from feasigrasp_lab.training.data.views import PartialView, ViewedObject

#: Points on the true surface that a shape is judged by.
SAMPLES = 2000
#: Completed points farther from the true surface than this are invented [m].
INVENTED = 0.01


def true_samples(viewed: ViewedObject, seed: int, count: int = SAMPLES) -> tuple[Array, Array]:
    """Points spread uniformly by area over the true surface and their normals, (count, 3) each."""
    points, faces = trimesh.sample.sample_surface(viewed.obj.mesh, count, seed=seed)
    return np.asarray(points), np.asarray(viewed.obj.mesh.face_normals[faces])


def measure(
    viewed: ViewedObject, field: Gpdf, views: Sequence[PartialView], points: Array, normals: Array
) -> dict[str, float]:
    """Compares a completed shape with the truth.

    Args:
        viewed: The object.
        field: The completed shape, in O.
        views: What it was made from.
        points: Points on the true surface, shape (n, 3) [m].
        normals: Their normals, shape (n, 3).

    Returns:
        By name: distances in mm, angles in degrees, shares in percent. NaN where there is nothing
        to measure (no unseen point, say).
    """
    in_sight, seen = np.any([viewed.sees(points, normals, view) for view in views], axis=0)
    hidden, judged = ~in_sight, ~in_sight | seen
    surface = sample_level_set(field, (field.points, points))
    distance = 1e3 * surface.distance(points)
    on_surface = replace(field, damped=True).refine(points[seen])[2]
    cosine = np.einsum("ij,ij->i", on_surface, normals[seen])
    used = field.completion.points
    dense_error, used_error = viewed.surface.distance(surface.points), viewed.surface.distance(used)
    weight = surface.area / max(surface.area.sum(), 1e-30)
    return {
        "true_to_completed_mm": float(distance.mean()),
        "seen_mm": _mean(distance[seen]),
        "unseen_mm": _mean(distance[hidden]),
        "unseen_p95_mm": float(np.percentile(distance[hidden], 95)) if hidden.any() else np.nan,
        "normal_seen_deg": float(np.rad2deg(np.arccos(np.clip(np.median(cosine), -1.0, 1.0)))),
        "variance_auc": auc(field.variance(points[judged]), hidden[judged]),
        "variance_auc_in_sight": auc(field.variance(points), hidden),
        "invented_percent": 100.0 * _mean((used_error > INVENTED).astype(float)),
        "invented_area_percent": 100.0 * float(weight @ (dense_error > INVENTED)),
        "completed_to_true_mm": 1e3 * float(weight @ dense_error),
        "completed_points": float(len(used)),
    }


def auc(score: Array, positive: Mask) -> float:
    """`area_under_curve` of a score (n,) that should be larger for positives; NaN without both."""
    if positive.all() or not positive.any():
        return float("nan")
    return area_under_curve(score, positive).value


def _mean(values: Array) -> float:
    return float(np.mean(values)) if len(values) else float("nan")
