"""Relocalization of an object after a gap, from many starting poses."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.tracking.keyframe import is_cut
from feasigrasp.models.tracking.model import TrackedModel
from feasigrasp.models.tracking.registration import Registration, is_found, register
from feasigrasp.models.tracking.view import ObjectView

#: Turns that are tried [rad]: about each axis of the world, and those that leave no orientation
#: farther off than 63 degrees. Source: guessed.
_NEARBY = np.vstack([np.zeros(3), *(t * np.eye(3) for t in (0.4, -0.4, 0.8, -0.8))])
_ALL_ROUND = Rotation.create_group("O")
#: Points of the coarse search. Source: guessed.
_COARSE = 150
#: What the place is known to be worth after a gap, beside what the filter says [rad, m]; and after
#: a long one, in which the object may have turned to any side. Source: guessed.
SEARCH_SPREAD, ANY_ORIENTATION_SPREAD = (0.3, 0.05), (1.5, 0.1)
#: A model point that projects onto the background counts as this number of points of the object.
#: Source: guessed.
_BESIDE = 2.0


def registered(
    model: TrackedModel, view: ObjectView, X_WO: Array, covariance: Array
) -> Registration:
    """Registration from the expected pose, or from where the points are if that is far off.

    The arguments are those of `register`.
    """
    # Beyond such a step of the center of what is visible a registration may be out of reach [m].
    large = 0.008
    found = register(model, view, X_WO, covariance)
    facing = _facing(view, X_WO, *model.probes)
    if is_found(found) or is_cut(view) or len(facing) == 0:
        return found
    step = view.points_W.mean(axis=0) - facing.mean(axis=0) - X_WO[:3, 3]
    if np.linalg.norm(step) <= large:
        return found
    start = se3.make_pose(X_WO[:3, :3], X_WO[:3, 3] + step)
    other = register(model, view, X_WO, covariance, start=start)
    return other if is_found(other) else found


def reacquire(
    model: TrackedModel,
    view: ObjectView,
    guesses: Sequence[Array],
    covariance: Array,
    *,
    any_orientation: int | None = None,
) -> Registration:
    """The best registration of several, of an object in an image in which it may be.

    The guesses (4, 4) of its pose come with the most probable first; their errors [theta, p] have
    the covariance (6, 6). Where it may have turned by any angle, ``any_orientation`` is the seed of
    the turns that are tried: another one in every search, so that some start comes near.
    """
    starts = [(guess, X) for guess in guesses for X in _starts(model, view, guess, _NEARBY)]
    fits = np.array([_fit(model, view, X) for _, X in starts])
    # Number of nearby starts, those that fit best, that are followed.
    starts = [starts[k] for k in np.argsort(-fits)[:4]]
    if any_orientation is not None:  # without information from such a distance
        some = Rotation.from_quat(np.random.default_rng(any_orientation).standard_normal(4))
        turns = (some * _ALL_ROUND).as_rotvec()
        starts += [(guesses[0], X) for X in _starts(model, view, guesses[0], turns)]
    for _ in range(1 if any_orientation is None else 2):
        found = [
            register(model, view, guess, covariance, start=X, points=_COARSE) for guess, X in starts
        ]
        # Number of starts from far off that are followed once more.
        order = sorted(range(len(found)), key=lambda k: -_score(found[k]))[:6]
        starts = [(starts[k][0], found[k].X_WO) for k in order]
    return register(model, view, starts[0][0], covariance, start=starts[0][1])


def _score(found: Registration) -> float:
    """What speaks for a pose: points on the model, and its surface where it should be seen."""
    return found.on_model + found.covered - _BESIDE * found.beside


def _fit(model: TrackedModel, view: ObjectView, X_WO: Array) -> float:
    """How well a pose fits the image as it is: points on the surface, less surface beside them."""
    points = view.points_W[:: -(-len(view.points_W) // _COARSE)]
    distance, _ = model.distance((points - X_WO[:3, 3]) @ X_WO[:3, :3])
    facing = _facing(view, X_WO, *model.probes)
    found, _ = view.beside(view.in_camera(facing + X_WO[:3, 3]))
    beside = float(found.mean()) if len(found) else 0.0
    # A point counts by half at this distance from the surface [m].
    half = 0.006
    return float(np.mean(1.0 / (1.0 + (distance / half) ** 2))) - _BESIDE * beside


def _starts(model: TrackedModel, view: ObjectView, X_WO: Array, turns: Array) -> Iterator[Array]:
    """Where it is expected, and turned this way and that where the points are."""
    yield X_WO
    surface = model.gpdf.completion  # the visible side may be a new one
    for turn in turns:
        X = se3.make_pose(se3.so3_exp(turn) @ X_WO[:3, :3], X_WO[:3, 3])
        facing = _facing(view, X, surface.points, surface.normals)
        seen = facing if len(facing) else surface.points @ X[:3, :3].T
        X[:3, 3] = view.points_W.mean(axis=0) - seen.mean(axis=0)
        yield X


def _facing(view: ObjectView, X_WO: Array, points: Array, normals: Array) -> Array:
    """Points in O that face the camera, from its origin, in the axes of the world (k, 3)."""
    lever, normals_W = points @ X_WO[:3, :3].T, normals @ X_WO[:3, :3].T
    towards = view.X_WC[:3, 3] - (lever + X_WO[:3, 3])
    return np.asarray(lever[np.einsum("ij,ij->i", towards, normals_W) > 0.0])
