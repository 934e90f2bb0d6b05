"""Registration of one image to a field and silhouette by Gauss-Newton steps; relocalization.

Maximum a posteriori: Gauss-Newton steps on

    sum_i rho(d(R^T (x_i - p))^2 / s_i^2) / N + e^T P^-1 e

where d is the distance field (`TrackedModel.distance`), e = [theta, p] the deviation from the
expected pose, P its covariance, and rho that of Geman and McClure. Three kinds of residuals are
summed:

- the distance of every point from the field, with ``s^2`` of the sensor and of the surface:
  completed surface counts the less, the farther it is from what was observed;
- where there is one, its distance from the tangent plane of the nearest observed point, which
  keeps thin walls and edges that the field rounds off;
- for model points that project onto the background, the way back to the silhouette. Without
  it a model that sticks out beyond the data would cost nothing.

Points at an open end of the observed surface (`TrackedModel.open_ends`) are left out, as those at
the rim of a mesh usually are. Of the information that the shape seems to give, that of noise is
taken off (`without_noise`).

References: Geman, McClure, "Statistical methods for tomographic image reconstruction", 1987; Chen,
Medioni, "Object modelling by registration of multiple range images", 1992; Turk, Levoy, "Zippered
polygon meshes from range images", 1994.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3
from feasigrasp.models.tracking.model import TrackedModel, jacobian, without_noise
from feasigrasp.models.tracking.twist_filter import moved, pose_error
from feasigrasp.models.tracking.view import ObjectView

#: Errors of neighbouring pixels and model points correlate: this number counts as one. Source:
#: guessed.
CORRELATED = 20.0


@dataclass(frozen=True, eq=False)
class Registration:
    """Registered pose of an object in one image.

    Attributes:
        X_WO: The most likely pose, shape (4, 4).
        information: What the image alone says of [theta, p] there, shape (6, 6).
        inliers: Share of the object's points that lie on the model, of those that are not new.
        beside: Share of the model's points facing the camera that project onto the background.
        in_view: Share of the known surface that faces the camera which is in the image, far enough
            away to be measured and, where it is expected, behind nothing else.
        inside: Share of all of the known surface that is in the image and far enough away, which
            says more of a side that is new.
        covered: Share of the model's points in view that project onto the object; 0 without any.
        facing: Share of the known surface that faces the camera. Where there is hardly any, the
            other shares of it say nothing: the visible side is another.
        new: Share of the object's points that are neither on the model nor near any that was
            observed: of a side of which the model is a guess.
    """

    X_WO: Array
    information: Array
    inliers: float
    beside: float
    in_view: float
    inside: float
    covered: float
    facing: float
    new: float

    @property
    def on_model(self) -> float:
        """Share of all the object's points that lie on the model."""
        return self.inliers * (1.0 - self.new)


def register(
    model: TrackedModel,
    view: ObjectView,
    X_WO: Array,
    covariance: Array,
    *,
    start: Array | None = None,
    points: int = 450,
) -> Registration:
    """Finds the pose of an object in an image, by at most so many points, spread over it.

    It is expected at X_WO (4, 4) with a covariance (6, 6) of the error [theta, p]; the search
    starts there, unless another pose is given.
    """
    # Steps of the search; residuals are allowed to be so large at its start [m], at most.
    steps, widest = 6, 0.012
    # A residual below this [m], or this number of standard deviations, is an inlier's.
    least_inlier, sigmas = 3e-3, 3.0
    # A point this near to an observed one is on observed surface [m]; beyond, the surface is a
    # guess that errs by this share of the distance.
    observed_within, guess_share = 4e-3, 0.5
    every = -(-len(view.points_W) // points)
    x, x_C = view.points_W[::every], view.points_C[::every]
    # Variance of the depth [m^2]; a residual's standard deviation is at least that of bumps of the
    # model [m].
    sensor = (view.camera.depth_noise * np.square(x_C[:, 2])) ** 2 + 5e-4**2
    prior: Array = np.asarray(np.linalg.inv(covariance), dtype=float)
    X: Array = X_WO if start is None else start
    wide = widest
    if start is None:
        wide = min(widest, 3.0 * float(np.sqrt(np.trace(covariance[3:, 3:]) / 3.0)) + 2e-3)
    gap, nearest = model.tree.query((x - X[:3, 3]) @ X[:3, :3])
    for step in range(steps + 1):
        rotation, center = X[:3, :3], X[:3, 3]
        lever = x - center
        local = lever @ rotation
        if step < steps and step % 3 == 2:
            gap, nearest = model.tree.query(local)
        distance, normals = model.distance(local)
        at_end = model.open_ends[nearest]
        guess = (guess_share * np.maximum(gap - observed_within, 0.0)) ** 2
        variance = sensor + guess
        inlier = np.abs(distance) < np.maximum(least_inlier, sigmas * np.sqrt(sensor))
        scale = wide * 0.5**step
        weight = np.where(at_end, 0.0, _robust(distance, variance, scale))
        planes = model.normals[nearest]
        # A tangent plane is one for points so near [m] whose field has the same normal (cosine).
        on_plane = (np.einsum("ij,ij->i", normals, planes) > 0.8) & (gap < 5e-3) & ~at_end
        offset = np.einsum("ij,ij->i", local - model.points[nearest], planes)
        plane_weight = np.where(on_plane, _robust(offset, variance, scale), 0.0)
        # Both together count as one.
        both = np.where(on_plane, 0.5, 1.0)
        rows = np.vstack(
            [jacobian(lever, normals @ rotation.T), jacobian(lever, planes @ rotation.T)]
        )
        weights = np.concatenate([both * weight, 0.5 * plane_weight]) / CORRELATED
        residuals = np.concatenate([distance, offset])
        both_levers = np.vstack([lever, lever])
        information, projection = without_noise(rows, weights, both_levers, model.noise_share)
        gradient = projection @ (rows.T @ (weights * residuals))
        rim_rows, rim_weights, rim_residuals, shown = _silhouette(model, view, X)
        # A small part of the object errs together.
        # Where less of the surface than this share is inside the image, it counts by the square of
        # that.
        share = min(1.0, shown["inside"] / 0.5) ** 2
        information, gradient = share * information, share * gradient
        information = information + rim_rows.T @ (rim_weights[:, None] * rim_rows)
        gradient = gradient + rim_rows.T @ (rim_weights * rim_residuals)
        if step == steps:
            break
        # The prior's gradient: errors are small enough to add up as vectors.
        gradient = gradient + prior @ pose_error(X_WO, X)
        change = -np.linalg.solve(information + prior, gradient)
        X = moved(X, change)
        # Steps smaller than this end the search [rad, m].
        if scale < 1e-3 and np.abs(change).max() < 1e-4:
            break
    # One this far from any is new, beyond what the sensor's noise explains [m].
    known = inlier | ~at_end & (gap < 1e-2 + sigmas * np.sqrt(sensor))
    new = float(1.0 - known.mean())
    inliers = float(inlier[known].mean()) if known.any() else 0.0
    return Registration(X, information, inliers, new=new, **shown)


def _robust(residual: Array, variance: Array, scale: float) -> Array:
    """Weights of Geman and McClure, divided by the variance, shape (n,)."""
    # Residuals beyond this number of standard deviations count less.
    limit = np.maximum(3.0**2 * variance, scale**2)
    return np.asarray(1.0 / (variance * (1.0 + residual**2 / limit) ** 2))


def _silhouette(
    model: TrackedModel, view: ObjectView, X_WO: Array
) -> tuple[Array, Array, Array, dict[str, float]]:
    """Rows, weights and residuals of model points that the camera sees past.

    And what the image shows of the model, by the names of `Registration`.
    """
    lever, normals_W = model.placed(X_WO[:3, :3])
    points_W = lever + X_WO[:3, 3]
    towards = view.X_WC[:3, 3] - points_W
    length = np.linalg.norm(towards, axis=1)
    facing = np.einsum("ij,ij->i", towards, normals_W) > 0.3 * length
    points_C = view.in_camera(points_W)
    shown = view.camera.in_image(points_C)
    inside = float(shown.mean())
    if not facing.any():
        nothing = dict(beside=0.0, in_view=0.0, inside=inside, covered=0.0, facing=0.0)
        return np.zeros((0, 6)), np.zeros(0), np.zeros(0), nothing
    lever, points_C, shown = lever[facing], points_C[facing], shown[facing]
    on = view.on_object(points_C[shown])
    visible = on | ~view.hidden(points_C[shown])  # what a finger is before may be there or not
    found, way = view.beside(points_C)
    result = dict(
        beside=float(found.mean()),
        in_view=float(visible.sum() / len(shown)),
        inside=inside,
        covered=float(on[visible].mean()) if visible.any() else 0.0,
        facing=float(facing.mean()),
    )
    excess = np.linalg.norm(way, axis=1)
    # Towards the silhouette, at right angles to the line of sight; r = -excess grows towards it.
    direction = np.column_stack([way / np.maximum(excess, 1e-9)[:, None], np.zeros(len(way))])
    at = points_C[found]
    direction[:, 2] = -np.einsum("ij,ij->i", direction[:, :2], at[:, :2]) / at[:, 2]
    normals_W = direction @ view.X_WC[:3, :3].T
    rows = -jacobian(lever[found], normals_W)
    # Standard deviation of the silhouette, in pixels.
    sigma = 2.0 * at[:, 2] / view.camera.intrinsics[0]
    weights = _robust(excess, sigma**2, 5e-3) / CORRELATED
    return rows, weights, -excess, result


#: Less of the known, facing surface in an image than this share is little. Source: guessed.
_LITTLE = 0.25
#: Less of the known surface than this faces a camera that sees another side. Source: guessed.
_LEAST_FACING = 0.03


def is_accepted(found: Registration) -> bool:
    """Acceptance test of a pose near the expected one."""
    # What an image must show for its pose to be accepted: shares of the known surface that are
    # inside the image, of points on the model, of the facing model inside the image that is seen,
    # and, at most, of the facing model that projects beside the object. How much it then says is
    # left to the information: little of the object determines little.
    least_inside, least_inliers, least_covered, most_beside = 0.05, 0.6, 0.5, 0.35
    # Where little is in the image, more of the points must be on the model; where hardly any is,
    # the observed side is new, and its observed part says nothing.
    least_inliers_of_little, new_side = 0.7, 0.02
    little = found.in_view < _LITTLE
    # Points of a new side need not be on the model; this share of all is at least.
    return (
        found.inside >= least_inside
        and found.inliers >= (least_inliers_of_little if little else least_inliers)
        and found.on_model >= 0.45
        and (found.covered >= least_covered or found.in_view < new_side)
        and found.beside <= most_beside
    )


def shows_model(found: Registration) -> bool:
    """Whether enough of the modeled surface is in the image."""
    return found.in_view >= _LITTLE and found.facing >= _LEAST_FACING


def is_found(found: Registration, *, any_orientation: bool = False) -> bool:
    """Acceptance test of a relocalized pose.

    At ``any_orientation``, where it was searched for at all of them, some wrong one fits as well.
    """
    # A pose that is not where it was expected has so much of the points on the model, of the model
    # beside the object, and of what is in view seen; and if any turn was tried.
    shares, shares_at_any_orientation = (0.85, 0.1, 0.7), (0.95, 0.05, 0.8)
    least_on, most_beside, least_covered = shares_at_any_orientation if any_orientation else shares
    # The share of the facing surface that it shows in the image.
    return (
        is_accepted(found)
        and found.facing >= _LEAST_FACING
        and found.in_view >= 0.3
        and found.on_model > least_on
        and found.beside < most_beside
        and found.covered >= least_covered
    )


# Relocalization of an object after a gap, from many starting poses.

#: Turns that are tried [rad]: about each axis of the world, and those that leave no orientation
#: farther off than 63 degrees. Source: guessed.
_NEARBY = np.vstack([np.zeros(3), *(t * np.eye(3) for t in (0.4, -0.4, 0.8, -0.8))])
_ALL_ROUND = Rotation.create_group("O")
#: Points of the coarse search. Source: guessed.
_COARSE = 150
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
    if is_found(found) or view.at_border.any() or len(facing) == 0:
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
    """Score of a pose: points on the model, and its surface where it should be seen."""
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
    """Start poses: the expected one, and turned ones at the mean of the points."""
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
