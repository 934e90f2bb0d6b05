"""Finds an object again that was out of sight, from several starts."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.tracking.model import TrackedModel
from feasigrasp.models.tracking.registration import Registration, register
from feasigrasp.models.tracking.view import ObjectView

#: Turns about each axis of the world that are tried [rad].
_TURNS = (0.5, -0.5)
#: A coarse search uses so many points.
_COARSE = 150
#: What the place is known to be worth after a gap, beside what the filter says [rad, m].
UNSURE = (0.3, 0.05)
#: A model point that projects onto the background is worth so many points of the object.
_BESIDE = 2.0


def reacquire(
    model: TrackedModel, view: ObjectView, X_WO: Array, covariance: Array
) -> Registration:
    """The best registration of several.

    Args:
        model: The object.
        view: An image in which it may be.
        X_WO: Where it would be by now, shape (4, 4).
        covariance: Of the error [theta, p] of that, shape (6, 6).
    """
    found = [
        register(model, view, X_WO, covariance, start=start, points=_COARSE)
        for start in _starts(model, view, X_WO)
    ]
    best = max(found, key=lambda r: r.inliers - _BESIDE * r.beside)
    return register(model, view, X_WO, covariance, start=best.X_WO)


def _starts(model: TrackedModel, view: ObjectView, X_WO: Array) -> Iterator[Array]:
    """Where it is expected, and turned this way and that where the points are."""
    yield X_WO
    for turn in (np.zeros(3), *(t * axis for t in _TURNS for axis in np.eye(3))):
        X = se3.make_pose(se3.so3_exp(turn) @ X_WO[:3, :3], X_WO[:3, 3])
        points, normals = model.probes
        points_W = points @ X[:3, :3].T + X[:3, 3]
        towards = view.X_WC[:3, 3] - points_W
        facing = np.einsum("ij,ij->i", towards, normals @ X[:3, :3].T) > 0.0
        seen = points_W[facing] if facing.any() else points_W
        X[:3, 3] += view.points_W.mean(axis=0) - seen.mean(axis=0)
        yield X
