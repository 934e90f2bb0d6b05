"""Follows an object by its own distance field, image by image.

The frame O is that of the first view: its origin is the middle of what was seen, its axes are those
of the world. What was seen there is the first keyframe, from which somebody fits a field; once
there is one, every image is registered to it, and images that are good enough to teach the model
something are keyframes again. The pose of a keyframe is the tracked one: merging does not move O.
"""

from __future__ import annotations

from collections.abc import Callable
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
from feasigrasp.models.tracking.reacquisition import ANYHOW, UNSURE, reacquire
from feasigrasp.models.tracking.registration import Registration, register
from feasigrasp.models.tracking.twist_filter import TwistFilter
from feasigrasp.models.tracking.view import ObjectView

#: A first view has at least so many points, any other so many.
_FIRST_POINTS, _LEAST_POINTS = 300, 80
#: What an image must show for its pose to be believed: shares of the known surface that are inside
#: the image, of points on the model, of the facing model inside the image that is seen, and, at
#: most, of the facing model that projects beside the object. How much it then says is left to the
#: information: little of the object determines little.
_LEAST_INSIDE, _LEAST_INLIERS, _LEAST_COVERED, _MOST_BESIDE = 0.05, 0.6, 0.5, 0.35
#: Points of a new side are not asked to be on the model; so many of all are at least.
_LEAST_ON_MODEL = 0.45
#: Where less than this share of the known, facing surface is in the image, so many points must be;
#: where hardly any is, what is seen is a new side, and what of it is seen says nothing.
_LITTLE, _INLIERS_OF_LITTLE, _NEW_SIDE = 0.25, 0.7, 0.02
#: An object whose surface is known no better than this is not tracked, though some is seen [m].
_MOST_DEVIATION = 5e-3
#: The same for a keyframe, and the surface's standard deviation [m]; the shares are also asked for
#: after a gap.
_KEY_VIEW, _KEY_INLIERS, _KEY_BESIDE, _KEY_DEVIATION = 0.7, 0.85, 0.1, 1.6e-3
#: A side so far from all that were seen [rad], or a view of which such a share is new, is taken as
#: soon as these allow it: once nothing that is known is in the image any more, it is too late.
_OTHER_SIDE, _NEW_PART = np.deg2rad(30.0), 0.25
_OTHER_VIEW, _OTHER_INLIERS, _OTHER_DEVIATION = 0.35, 0.75, 2.5e-3
#: Time between keyframes at least [s]; views of one side that suffice; when it is looked at again.
KEY_PERIOD, KEY_VIEWS, _KEY_REVISIT = 0.09, 10, 5.0
#: A keyframe has so many points at most: what more there are of a near object are closer together
#: than the model is fine.
_KEY_POINTS = 6000
#: Points so near to the border of an image are where it cuts the object off, until an image shows
#: what is so far around them [px]; so many are kept of an image, and of all.
_AT_BORDER, _SEEN_PAST = 4.0, 12.0
_CUT_POINTS, _MOST_CUT = 60, 600
#: Of a side that was seen so many times there are fewer: so much time between them [s].
_KNOWN_SIDE, _KNOWN_PERIOD = 3, 0.4
#: After so long without a pose the object is searched for from several starts, and again so much
#: later [s].
_SEARCH_AFTER, _SEARCH_PERIOD = 0.25, 0.2
#: After such a gap little in the image is not enough, and any turn is tried [s]; a pose that was
#: searched for shows such a share of the facing surface in the image.
_LONG_GAP, _FOUND_VIEW = 1.0, 0.3
#: It has so much of the points on the model, of the model beside the object, and of what is in view
#: seen; and if any turn was tried.
_FOUND, _ANYHOW_FOUND = (0.85, 0.1, 0.7), (0.95, 0.05, 0.8)
#: A pose so far from the expected one is asked for the same [m].
_LARGE_STEP = 0.01
#: A merged view moves the model by its own error, as one of so many views, and by this share of it
#: at least: where it shows another side it is the only one.
_LEAST_SHARE = 0.2
#: What is known without any image of where a model is: standard deviations [rad, m].
_UNKNOWN = (0.3, 0.03)
#: What the tracked path is worth to the predictor of the motion.
_PATH_NOISE = Noise(position=1.5e-3, rotation=8e-3)


@dataclass(frozen=True, eq=False)
class Keyframe(Frozen):
    """A view that is worth merging.

    Attributes:
        points_O: Points of the object in O, shape (n, 3) [m].
        p_OC: Position of the camera in O, shape (3,) [m].
        time: Of the image [s].
        deviation: How far the surface may be from there, across itself [m].
    """

    points_O: Array
    p_OC: Array
    time: float
    deviation: float = 0.0


@dataclass(frozen=True, eq=False)
class FieldTrack(Frozen):
    """What a tracker knows after an image.

    Attributes:
        image_time: Time of the last image [s]; -inf before the first.
        X_WC: Pose of the camera at that time, shape (4, 4); None before.
        measured: Pose and twist at the last image that a pose was got from; None before.
        estimate: Pose and twist at that time, or where they are expected to be at that of the last
            image; None before the first view.
        model: The shape; None until there is one.
        in_view: Share of the known surface facing the camera that was in the last image.
        deviation: Standard deviation of the surface across itself [m].
        information: What that image alone said of the pose, shape (6, 6); zero before.
        keyframe: The last view worth merging; None before the first.
        cut: Points of the object where the images worth merging ended, in O, shape (k, 3) [m].
        searched_at: When it was last searched for from several starts [s].
        motion: State of the filter that predicts, see `feasigrasp.models.objects.pose_filter`.
    """

    image_time: float = -np.inf
    X_WC: Array | None = None
    measured: TwistFilter | None = None
    estimate: TwistFilter | None = None
    model: TrackedModel | None = None
    in_view: float = 0.0
    deviation: float = np.inf
    information: Array = field(default_factory=lambda: np.zeros((6, 6)))
    keyframe: Keyframe | None = None
    cut: Array = field(default_factory=lambda: np.zeros((0, 3)))
    searched_at: float = -np.inf
    motion: Array = field(default_factory=empty_state)

    @property
    def measured_at(self) -> float:
        """Time of the last image that a pose was got from [s]; NaN before."""
        return np.nan if self.measured is None else self.measured.time

    def state(self, time: float, silence: float) -> TrackingState:
        """What the tracker does at a time."""
        if self.estimate is None:
            return TrackingState.SEARCHING
        age = time - self.measured_at
        if age >= silence:
            return TrackingState.LOST
        known = age <= COASTING_AFTER and self.deviation < _MOST_DEVIATION
        return TrackingState.TRACKING if known else TrackingState.COASTING


def track(
    before: FieldTrack,
    view: ObjectView,
    time: float,
    gpdf: Gpdf | None,
    views: ViewRecord,
    *,
    held: bool = False,
    second: Callable[[], ObjectView | None] | None = None,
) -> FieldTrack:
    """Takes in one image.

    Args:
        before: What was known before; `FieldTrack` to begin with.
        view: The image.
        time: When it was taken [s]; one not later than the last is ignored.
        gpdf: The field of what was merged so far, in O; None until there is one.
        views: From where the merged views were taken.
        held: Whether the hand that carries the camera has the object: it moves with both, and is
            not learnt from, since fingers hide a part of it.
        second: Gives the view of another camera at that time, or None; it is asked where ``view``
            does not show the object. A pose comes of it, and nothing is learnt.
    """
    if not time > before.image_time or not np.isfinite(view.X_WC).all():
        return before
    estimate, last, model = before.estimate, before.measured, before.model
    if estimate is None or last is None:
        return _begun(before, view, time)
    if gpdf is not None and (model is None or model.gpdf is not gpdf):
        model = TrackedModel(gpdf, before.cut)
        estimate = estimate.widened(_one_view(before.information, len(views.times)))
    X_WC_before = before.X_WC
    before = replace(before, image_time=time, model=model, X_WC=view.X_WC)
    gap = time - before.measured_at
    coasting = gap > COASTING_AFTER
    expected = estimate.predicted(time, coasting=coasting)
    if held and X_WC_before is not None:
        expected = expected.carried(estimate, view.X_WC @ se3.inverse(X_WC_before) @ estimate.X_WO)
    before = replace(before, estimate=expected)
    after, found = _located(before, view, gap)
    if found is not None:
        if not held and _is_key(after, found, view, views):
            assert after.estimate is not None
            key = _keyframe(view, after.estimate.X_WO, time, after.deviation)
            after = replace(after, keyframe=key, cut=_cut(after.cut, view, after.estimate.X_WO))
        return _passed_on(after)
    other = second() if second is not None else None
    if other is not None:
        searched_at = after.searched_at
        after, _ = _located(before, other, gap)
        after = replace(after, searched_at=max(searched_at, after.searched_at))
    return _passed_on(replace(after, in_view=0.0))


def _one_view(information: Array, views: int) -> Array:
    """How far a model may have moved with the view that was merged last: covariance, (6, 6).

    A view errs by as much as an image tells, and all that is measured by the model errs with it. A
    filter that does not know takes it for a motion.

    Args:
        information: What an image tells, shape (6, 6).
        views: How many the model is made of.
    """
    share = max(1.0 / max(views, 1), _LEAST_SHARE)
    least = np.diag(1.0 / np.square(np.repeat(_UNKNOWN, 3)))
    return np.asarray(share**2 * np.linalg.inv(information + least))


def _located(
    before: FieldTrack, view: ObjectView, gap: float
) -> tuple[FieldTrack, Registration | None]:
    """Where a view shows the object.

    Args:
        before: With the estimate of where it is expected at the time of the view.
        view: The view.
        gap: Time since the last pose [s].

    Returns:
        What is known after it, and how the view fits; ``before`` and None if it gives no pose, but
        with the time of a search.
    """
    model, expected, last = before.model, before.estimate, before.measured
    if model is None or expected is None or last is None or len(view.points_W) < _LEAST_POINTS:
        return before, None
    time = before.image_time
    found = register(model, view, expected.X_WO, expected.pose_covariance)
    near = np.linalg.norm(found.X_WO[:3, 3] - expected.X_WO[:3, 3]) <= _LARGE_STEP
    good = _believed(found) if near else _is_found(found)
    good = good and (gap < _LONG_GAP or found.in_view >= _LITTLE)
    may_search = gap > _SEARCH_AFTER and time >= before.searched_at + _SEARCH_PERIOD
    if not good and may_search and len(view.points_W) >= _FIRST_POINTS:
        before = replace(before, searched_at=time)
        # Where it is expected, and where it is if it has gone on as it went.
        anyhow = round(1e3 * time) if gap > _LONG_GAP else None
        unsure = np.diag(np.square(np.repeat(UNSURE if anyhow is None else ANYHOW, 3)))
        wide, on = expected.widened(unsure), last.pose(time)
        found = reacquire(model, view, (wide.X_WO, on), wide.pose_covariance, anyhow=anyhow)
        good = _is_found(found, anyhow=anyhow is not None)
        expected = wide if good else expected
    if not good:
        return before, None
    estimate = expected.measured(found.X_WO, found.information)
    deviation = surface_deviation(estimate.pose_covariance, *model.placed(estimate.X_WO[:3, :3]))
    after = replace(
        before,
        measured=estimate,
        estimate=estimate,
        in_view=found.in_view,
        deviation=deviation,
        information=found.information,
    )
    return after, found


def _begun(before: FieldTrack, view: ObjectView, time: float) -> FieldTrack:
    """The first view defines O."""
    if len(view.points_W) < _FIRST_POINTS:
        return replace(before, image_time=time)
    X_WO = se3.make_pose(np.eye(3), np.median(view.points_W, axis=0))
    estimate = TwistFilter.at_rest(time, X_WO)
    return _passed_on(
        replace(
            before,
            image_time=time,
            X_WC=view.X_WC,
            measured=estimate,
            estimate=estimate,
            in_view=1.0,
            deviation=0.0,
            keyframe=_keyframe(view, X_WO, time),
            cut=_cut(before.cut, view, X_WO),
        )
    )


def _believed(found: Registration) -> bool:
    little = found.in_view < _LITTLE
    return (
        found.inside >= _LEAST_INSIDE
        and found.inliers >= (_INLIERS_OF_LITTLE if little else _LEAST_INLIERS)
        and found.on_model >= _LEAST_ON_MODEL
        and (found.covered >= _LEAST_COVERED or found.in_view < _NEW_SIDE)
        and found.beside <= _MOST_BESIDE
    )


def _is_found(found: Registration, *, anyhow: bool = False) -> bool:
    """Whether a pose that is not where it was expected is believed: nothing speaks against it.

    Args:
        found: The pose.
        anyhow: Whether it was searched for at all orientations, where some wrong one fits as well.
    """
    least_on, most_beside, least_covered = _ANYHOW_FOUND if anyhow else _FOUND
    return (
        _believed(found)
        and found.in_view >= _FOUND_VIEW
        and found.on_model > least_on
        and found.beside < most_beside
        and found.covered >= least_covered
    )


def _is_key(after: FieldTrack, found: Registration, view: ObjectView, views: ViewRecord) -> bool:
    """Whether the view is good enough to be merged, and tells something."""
    assert after.keyframe is not None and after.estimate is not None
    time = after.image_time
    if not _believed(found) or time < after.keyframe.time + KEY_PERIOD:
        return False
    p_OC = _in_object(after.estimate.X_WO, view.X_WC[:3, 3])
    new_part = found.new > _NEW_PART
    if not _good_enough(after, found, other=new_part or views.turned(p_OC) > _OTHER_SIDE):
        return False
    if new_part or views.tells_more(p_OC, time, _KNOWN_SIDE, _KEY_REVISIT):
        return True
    late = time >= after.keyframe.time + _KNOWN_PERIOD
    return late and views.tells_more(p_OC, time, KEY_VIEWS, _KEY_REVISIT)


def _good_enough(after: FieldTrack, found: Registration, *, other: bool) -> bool:
    """Whether a pose is good enough to merge the view by it, of another side or of a known one."""
    in_view = _OTHER_VIEW if other else _KEY_VIEW
    inliers = _OTHER_INLIERS if other else _KEY_INLIERS
    deviation = _OTHER_DEVIATION if other else _KEY_DEVIATION
    sure = found.inliers > inliers and found.beside < _KEY_BESIDE
    return sure and found.in_view > in_view and after.deviation < deviation


def _keyframe(view: ObjectView, X_WO: Array, time: float, deviation: float = 0.0) -> Keyframe:
    points_W = view.points_W[:: -(-len(view.points_W) // _KEY_POINTS)]
    p_OC = _in_object(X_WO, view.X_WC[:3, 3])
    return Keyframe(_in_object(X_WO, points_W), p_OC, time, deviation)


def _cut(known: Array, view: ObjectView, X_WO: Array) -> Array:
    """Where what has been merged was cut off by an image, after one more view, shape (k, 3)."""
    known_W = known @ X_WO[:3, :3].T + X_WO[:3, 3]
    known = known[view.camera.to_border(view.in_camera(known_W)) < _SEEN_PAST]
    found = _in_object(X_WO, view.points_W[view.camera.to_border(view.points_C) < _AT_BORDER])
    some = found[:: max(1, -(-len(found) // _CUT_POINTS))]
    return np.concatenate([known, some])[-_MOST_CUT:]


def _in_object(X_WO: Array, points_W: Array) -> Array:
    return np.asarray((points_W - X_WO[:3, 3]) @ X_WO[:3, :3])


def _passed_on(track: FieldTrack) -> FieldTrack:
    """With the pose taken in by the filter that predicts."""
    assert track.estimate is not None
    motion = track.motion.copy()
    measure_kernel(motion, track.image_time, np.array(track.estimate.X_WO), _PATH_NOISE)
    return replace(track, motion=motion)
