"""Follows an object by its own distance field, image by image.

The frame O is that of the first view: its origin is the middle of what was seen, its axes are those
of the world. What was seen there is the first keyframe, from which somebody fits a field; once
there is one, every image is registered to it, and images that are good enough to teach the model
something are keyframes again. The pose of a keyframe is the tracked one: merging does not move O.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.clouds.view_record import ViewRecord
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.pose_filter import Noise, empty_state, measure_kernel
from feasigrasp.models.objects.tracking import COASTING_AFTER, TrackingState
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.tracking.information import surface_deviation
from feasigrasp.models.tracking.model import TrackedModel
from feasigrasp.models.tracking.reacquisition import UNSURE, reacquire
from feasigrasp.models.tracking.registration import Registration, register
from feasigrasp.models.tracking.twist_filter import TwistFilter
from feasigrasp.models.tracking.view import ObjectView

#: A first view has at least so many points, any other so many.
_FIRST_POINTS, _LEAST_POINTS = 300, 80
#: What an image must show for its pose to be believed: shares of the known, facing surface that are
#: in the image, of points on the model, and, at most, of the model that projects beside them.
_LEAST_VIEW, _LEAST_INLIERS, _MOST_BESIDE = 0.25, 0.6, 0.35
#: The same for a keyframe, and the surface's standard deviation [m].
_KEY_VIEW, _KEY_INLIERS, _KEY_BESIDE, _KEY_DEVIATION = 0.7, 0.85, 0.1, 1.2e-3
#: Time between keyframes at least [s]; views of one side that suffice; when it is looked at again.
KEY_PERIOD, KEY_VIEWS, _KEY_REVISIT = 0.09, 10, 5.0
#: After so long without a pose the object is searched for from several starts, and again so much
#: later [s].
_SEARCH_AFTER, _SEARCH_PERIOD = 0.25, 0.2
#: What the tracked path is worth to the predictor of the motion.
_PATH_NOISE = Noise(position=1.5e-3, rotation=8e-3)


@dataclass(frozen=True, eq=False)
class Keyframe(Frozen):
    """A view that is worth merging.

    Attributes:
        points_O: Points of the object in O, shape (n, 3) [m].
        p_OC: Position of the camera in O, shape (3,) [m].
        time: Of the image [s].
    """

    points_O: Array
    p_OC: Array
    time: float


@dataclass(frozen=True, eq=False)
class FieldTrack(Frozen):
    """What a tracker knows after an image.

    Attributes:
        image_time: Time of the last image [s]; -inf before the first.
        measured_at: Time of the last image that a pose was got from [s]; NaN before.
        estimate: Pose and twist at that time, or where they are expected to be at that of the last
            image; None before the first view.
        model: The shape; None until there is one.
        in_view: Share of the known surface facing the camera that was in the last image.
        deviation: Standard deviation of the surface across itself [m].
        keyframe: The last view worth merging; None before the first.
        searched_at: When it was last searched for from several starts [s].
        motion: State of the filter that predicts, see `feasigrasp.models.objects.pose_filter`.
    """

    image_time: float = -np.inf
    measured_at: float = np.nan
    estimate: TwistFilter | None = None
    model: TrackedModel | None = None
    in_view: float = 0.0
    deviation: float = np.inf
    keyframe: Keyframe | None = None
    searched_at: float = -np.inf
    motion: Array = field(default_factory=empty_state)

    def state(self, time: float, silence: float) -> TrackingState:
        """What the tracker does at a time."""
        if self.estimate is None:
            return TrackingState.SEARCHING
        age = time - self.measured_at
        if age >= silence:
            return TrackingState.LOST
        return TrackingState.COASTING if age > COASTING_AFTER else TrackingState.TRACKING


def track(
    before: FieldTrack, view: ObjectView, time: float, gpdf: Gpdf | None, views: ViewRecord
) -> FieldTrack:
    """Takes in one image.

    Args:
        before: What was known before; `FieldTrack` to begin with.
        view: The image.
        time: When it was taken [s]; one not later than the last is ignored.
        gpdf: The field of what was merged so far, in O; None until there is one.
        views: From where the merged views were taken.
    """
    if not time > before.image_time or not np.isfinite(view.X_WC).all():
        return before
    if before.estimate is None:
        return _begun(before, view, time)
    model = before.model
    if gpdf is not None and (model is None or model.gpdf is not gpdf):
        model = TrackedModel(gpdf)
    before = replace(before, image_time=time, model=model)
    gap = time - before.measured_at
    coasting = gap > COASTING_AFTER
    expected = before.estimate.predicted(time, coasting=coasting)  # type: ignore[union-attr]
    found = None
    if model is not None and len(view.points_W) >= _LEAST_POINTS:
        may_search = gap > _SEARCH_AFTER and time >= before.searched_at + _SEARCH_PERIOD
        found, expected, searched = _found(model, view, expected, may_search=may_search)
        before = replace(before, searched_at=time if searched else before.searched_at)
    if found is None:
        return _passed_on(replace(before, estimate=expected, in_view=0.0))
    estimate = expected.measured(found.X_WO, found.information)
    assert model is not None
    points, normals = model.probes
    R = estimate.X_WO[:3, :3]
    deviation = surface_deviation(estimate.pose_covariance, points @ R.T, normals @ R.T)
    after = replace(
        before,
        measured_at=time,
        estimate=estimate,
        in_view=found.in_view,
        deviation=deviation,
    )
    if _is_key(after, found, view, views):
        after = replace(after, keyframe=_keyframe(view, estimate.X_WO, time))
    return _passed_on(after)


def _begun(before: FieldTrack, view: ObjectView, time: float) -> FieldTrack:
    """The first view defines O."""
    if len(view.points_W) < _FIRST_POINTS:
        return replace(before, image_time=time)
    X_WO = se3.make_pose(np.eye(3), np.median(view.points_W, axis=0))
    return _passed_on(
        replace(
            before,
            image_time=time,
            measured_at=time,
            estimate=TwistFilter.at_rest(time, X_WO),
            in_view=1.0,
            keyframe=_keyframe(view, X_WO, time),
        )
    )


def _found(
    model: TrackedModel, view: ObjectView, expected: TwistFilter, *, may_search: bool
) -> tuple[Registration | None, TwistFilter, bool]:
    """A pose that can be believed, the estimate that it rests on, and whether it was searched for.

    An object of which too little is in the image is not searched for elsewhere.
    """
    found = register(model, view, expected.X_WO, expected.pose_covariance)
    if _believed(found):
        return found, expected, False
    if not may_search or len(view.points_W) < _FIRST_POINTS:
        return None, expected, False
    wide = expected.widened(UNSURE)
    found = reacquire(model, view, wide.X_WO, wide.pose_covariance)
    good = _believed(found) and found.inliers >= _KEY_INLIERS and found.beside < _KEY_BESIDE
    return (found, wide, True) if good else (None, expected, True)


def _believed(found: Registration) -> bool:
    return (
        found.in_view >= _LEAST_VIEW
        and found.inliers >= _LEAST_INLIERS
        and found.beside <= _MOST_BESIDE
    )


def _is_key(after: FieldTrack, found: Registration, view: ObjectView, views: ViewRecord) -> bool:
    """Whether the view is good enough to be merged, and tells something."""
    assert after.keyframe is not None and after.estimate is not None
    time = after.image_time
    good = (
        found.in_view > _KEY_VIEW
        and found.inliers > _KEY_INLIERS
        and found.beside < _KEY_BESIDE
        and after.deviation < _KEY_DEVIATION
    )
    if not good or time < after.keyframe.time + KEY_PERIOD:
        return False
    p_OC = _in_object(after.estimate.X_WO, view.X_WC[:3, 3])
    return views.tells_more(p_OC, time, KEY_VIEWS, _KEY_REVISIT)


def _keyframe(view: ObjectView, X_WO: Array, time: float) -> Keyframe:
    return Keyframe(_in_object(X_WO, view.points_W), _in_object(X_WO, view.X_WC[:3, 3]), time)


def _in_object(X_WO: Array, points_W: Array) -> Array:
    return np.asarray((points_W - X_WO[:3, 3]) @ X_WO[:3, :3])


def _passed_on(track: FieldTrack) -> FieldTrack:
    """With the pose taken in by the filter that predicts."""
    assert track.estimate is not None
    motion = track.motion.copy()
    measure_kernel(motion, track.image_time, np.array(track.estimate.X_WO), _PATH_NOISE)
    return replace(track, motion=motion)
