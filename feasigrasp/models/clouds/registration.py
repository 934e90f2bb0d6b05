"""Point-to-plane registration of one view to the merged views (Chen and Medioni 1992)."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3

#: Standard deviation of the tracked pose that is reckoned with: [rad] and [m], per axis.
TRACKING_SIGMA = (np.deg2rad(1.0), 2e-3)
#: Noise of a residual, sensor and smoothing together [m].
RESIDUAL_SIGMA = 1.5e-3
#: Points pair up if closer than this, in the first and the last step [m].
_GATE = (0.01, 0.004)
#: ... and if the cosine between their normals is larger than this.
_SAME_SIDE = 0.7
#: Fewer pairs determine no pose.
_MIN_PAIRS = 30
_STEPS = 6
#: Points of the view that are used, at most; they are spread over it.
_MAX_POINTS = 400
#: A correction beyond this many standard deviations is a wrong one.
_MAX_SIGMAS = 4.0
#: A correction that leaves more than this of the misfit follows noise, not an error of the tracker.
_MISFIT_LEFT = 0.95


def register_view(
    points: Array, normals: Array, model_points: Array, model_normals: Array
) -> Array:
    """Finds the small motion that brings a view onto the model.

    Gauss-Newton steps on the distances to the model's tangent planes (Chen & Medioni, "Object
    modelling by registration of multiple range images", 1992), with the tracked pose as a Gaussian
    prior: what the overlap does not determine, like the turn of a can about its axis, stays as
    tracked.

    Args:
        points: The view, smoothed, shape (n, 3) [m].
        normals: Its unit normals, shape (n, 3).
        model_points: Merged earlier views, shape (m, 3) [m].
        model_normals: Their unit normals, shape (m, 3).

    Returns:
        The correction to apply to the view, shape (4, 4). The identity if there is too little
        overlap, if it hardly improves the fit, or if it is larger than tracking errors are.
    """
    every = -(-len(points) // _MAX_POINTS)
    points, normals = points[::every], normals[::every]
    tree, center = cKDTree(model_points), model_points.mean(axis=0)
    sigma = np.repeat(TRACKING_SIGMA, 3)
    total = np.eye(4)
    for gate in np.linspace(*_GATE, _STEPS):
        moved = points @ total[:3, :3].T + total[:3, 3]
        turned = normals @ total[:3, :3].T
        distance, nearest = tree.query(moved, distance_upper_bound=gate)
        found = np.flatnonzero(np.isfinite(distance))
        other = nearest[found]
        same = np.einsum("ij,ij->i", turned[found], model_normals[other]) > _SAME_SIDE
        found, other = found[same], other[same]
        if len(found) < _MIN_PAIRS:
            return np.eye(4)
        n = turned[found] + model_normals[other]
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        residual = np.einsum("ij,ij->i", moved[found] - model_points[other], n)
        weight = 1.0 / (1.0 + (residual / (2.0 * RESIDUAL_SIGMA)) ** 2) ** 2
        jacobian = np.hstack([np.cross(moved[found] - center, n), n])
        weighted = jacobian * (weight / RESIDUAL_SIGMA**2)[:, None]
        so_far = _about(se3.log(total), center)
        hessian = weighted.T @ jacobian + np.diag(sigma**-2)
        step = -np.linalg.solve(hessian, weighted.T @ residual + so_far / sigma**2)
        total = _exp_about(step, center) @ total
    corrected, tracked = (
        _spread(points, X, tree, model_points, model_normals) for X in (total, np.eye(4))
    )
    too_far = np.abs(_about(se3.log(total), center)) > _MAX_SIGMAS * np.sqrt(2.0) * sigma
    return np.eye(4) if too_far.any() or corrected >= _MISFIT_LEFT * tracked else total


def _spread(
    points: Array, X: Array, tree: cKDTree, model_points: Array, model_normals: Array
) -> float:
    """Mean distance of the view's points to the model's tangent planes, outliers cut off."""
    moved = points @ X[:3, :3].T + X[:3, 3]
    nearest = tree.query(moved)[1]
    offset = np.abs(np.einsum("ij,ij->i", moved - model_points[nearest], model_normals[nearest]))
    apart = np.linalg.norm(moved - model_points[nearest], axis=1)
    return float(np.where(apart < _GATE[0], np.minimum(offset, _GATE[1]), _GATE[1]).mean())


def _exp_about(v: Array, center: Array) -> Array:
    """Motion by the twist v = [angular; linear] about a center instead of the origin, (4, 4)."""
    X = se3.exp(v)
    X[:3, 3] += center - X[:3, :3] @ center
    return X


def _about(v: Array, center: Array) -> Array:
    """The twist of the same motion taken about a center."""
    return np.concatenate([v[:3], v[3:] + np.cross(v[:3], center)])
