"""Frame-to-model tracking of an object by its distance field, which is refined on the way.

The frame O is that of the first view: its origin is the center of the visible points, its axes are
those of the world. This view is the first keyframe, from which a field is fitted elsewhere; once
there is one, every image is registered to it, and images that are good enough to teach the model
something are keyframes again. Until then the middle of the observed points gives the object's
motion: a quick one would be out of a search's reach otherwise. The pose of a keyframe is the
tracked one: merging does not move O. An object that is in sight as a whole for a while, and fits no
pose, is begun anew: what was learnt of it is wrong, or was not its side.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np

from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.clouds.checks import ViewFault, ViewRecord, usable_points
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.pose_filter import Noise, empty_state, measure_kernel, parts
from feasigrasp.models.objects.prediction import MotionEstimate, future_poses
from feasigrasp.models.objects.tracking import COASTING_AFTER, TrackingState
from feasigrasp.models.quantities import UNKNOWN_POSE, ArrayOf, Bound, Instant, NotNegative, Share
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.tracking.keyframe import (
    KEY_PERIOD,
    Keyframe,
    cut_off,
    is_worth_merging,
    keyframe_of,
    outlined,
)
from feasigrasp.models.tracking.model import TrackedModel, surface_deviation
from feasigrasp.models.tracking.registration import (
    Registration,
    is_accepted,
    is_found,
    reacquire,
    registered,
    shows_model,
)
from feasigrasp.models.tracking.twist_filter import JERK, TwistFilter, moved, pose_error
from feasigrasp.models.tracking.view import ObjectView

#: Least points of a first view: 2.3 cm at 0.5 m show 70. Source: measured.
FIRST_POINTS = 60
#: After such a gap little in the image is not enough, and any turn is tried [s]. Source: guessed.
_LONG_GAP = 1.0
_STATE = ArrayOf(empty_state().shape, finite=False)


@dataclass(frozen=True, eq=False)
class FieldTrack(Frozen):
    """State of the tracker after an image.

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
        begun_at: Time of the first view, that of O [s]; -inf before.
        unknown_since: Since when the whole object has been in sight without being recognised [s];
            inf if it is not.
        motion: State of the filter that predicts, see `feasigrasp.models.objects.pose_filter`.
        measured_motion: The same at the last image that a pose was got from.
        delay: How much later than it was taken the last image was there [s].
    """

    image_time: Instant = -np.inf
    X_WC: Annotated[Array, UNKNOWN_POSE] | None = None
    measured: TwistFilter | None = None
    estimate: TwistFilter | None = None
    model: TrackedModel | None = None
    in_view: Share = 0.0
    deviation: Bound = np.inf
    information: Annotated[Array, ArrayOf((6, 6))] = field(default_factory=lambda: np.zeros((6, 6)))
    keyframe: Keyframe | None = None
    cut: Annotated[Array, ArrayOf(("k", 3), "m")] = field(default_factory=lambda: np.zeros((0, 3)))
    searched_at: Instant = -np.inf
    begun_at: Instant = -np.inf
    unknown_since: Instant = np.inf
    motion: Annotated[Array, _STATE] = field(default_factory=empty_state)
    measured_motion: Annotated[Array, _STATE] = field(default_factory=empty_state)
    delay: NotNegative = 0.0

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def measured_at(self) -> float:
        """Time of the last image that a pose was got from [s]; NaN before."""
        return np.nan if self.measured is None else self.measured.time

    @checked()
    def age(self, time: float) -> float:
        """Age of the last measured pose at a time, beyond the delay of the images [s]."""
        return time - self.measured_at - self.delay

    @checked()
    def state(self, time: float, silence: Bound) -> TrackingState:
        """Tracking state at a time."""
        if self.estimate is None:
            return TrackingState.SEARCHING
        age = self.age(time)
        if age >= silence:
            return TrackingState.LOST
        # An object whose surface is known no better than this is not tracked, though some is seen
        # [m].
        known = age <= COASTING_AFTER and self.deviation < 5e-3
        return TrackingState.TRACKING if known else TrackingState.COASTING


@checked()
def track(
    before: FieldTrack,
    view: ObjectView,
    time: float,
    gpdf: Gpdf | None,
    views: ViewRecord,
    *,
    looked: Instant = -np.inf,
    held: bool = False,
    second: Callable[[], ObjectView | None] | None = None,
) -> FieldTrack:
    """Takes in one image.

    Args:
        before: What was known before; `FieldTrack` to begin with.
        view: The image.
        time: When it was taken [s]; one not later than the last is ignored.
        gpdf: The field of the merged views, in O; None until there is one. One of views from
            before O was begun is of another O, and not used.
        views: From where the merged views were taken.
        looked: Time of the last keyframe that shape completion has taken up [s].
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
    if not len(views.times) or views.times[0] < before.begun_at:
        gpdf = None
    if gpdf is not None and (model is None or model.gpdf is not gpdf):
        model = TrackedModel(gpdf, before.cut)
        estimate = estimate.widened(_one_view(before.information, len(views.times)))
    X_WC_before = before.X_WC
    before = replace(before, image_time=time, model=model, X_WC=view.X_WC)
    gap = time - before.measured_at
    coasting = gap > COASTING_AFTER
    expected = estimate.predicted(time, coasting=coasting)
    # So many points of a path make it known: out of sight an object is expected on it.
    if coasting and parts(before.measured_motion).stored[0] >= 12:
        expected = expected.gone_on(*_along_its_path(before, last, gap))
    if held and X_WC_before is not None:
        expected = expected.carried(estimate, view.X_WC @ se3.inverse(X_WC_before) @ estimate.X_WO)
    before = replace(before, estimate=expected)
    whole = len(view.points_W) >= FIRST_POINTS and not view.at_border.any()
    if model is None and whole and before.keyframe is not None and looked >= before.keyframe.time:
        return _begun(before, view, time)  # no field came of the first view
    if model is None:
        return _passed_on(_by_middle(before, view))
    after, found = _located(before, view, gap)
    if found is not None:
        assert after.estimate is not None and before.keyframe is not None
        if not held and time >= before.keyframe.time + KEY_PERIOD:
            X_WO = after.estimate.X_WO
            key = keyframe_of(view, X_WO, time, after.deviation, begun_at=after.begun_at)
            if is_worth_merging(key, found, before.keyframe.time, views):
                key, cut = outlined(key, view, X_WO), cut_off(after.cut, view, X_WO)
                after = replace(after, keyframe=key, cut=cut)
        return _passed_on(after)
    other = second() if second is not None else None
    if other is not None:
        searched_at = after.searched_at
        after, _ = _located(before, other, gap)
        after = replace(after, searched_at=max(searched_at, after.searched_at))
    unknown = whole and gap > _LONG_GAP and not held and after.measured_at < time
    after = replace(after, unknown_since=min(after.unknown_since, time) if unknown else np.inf)
    # An object that is seen as a whole is not recognised for so long: what is known is given up
    # [s].
    given_up = 0.6
    if time - after.unknown_since >= given_up:
        return _begun(after, view, time)
    return _passed_on(replace(after, in_view=0.0))


def _along_its_path(before: FieldTrack, last: TwistFilter, gap: float) -> tuple[Array, Array]:
    """Pose and twist of an object that was last seen ``gap`` [s] ago; it slows down on its path."""
    motion = MotionEstimate(before.measured_motion, last.time, last.X_WO)
    # Time over which it slows down: a wrong path must not lead the hand away. Time over
    # which its twist there is taken [s].
    slowing, step = 2.0, 1e-3
    way = slowing * (1.0 - np.exp(-gap / slowing))
    X, after = future_poses(motion, last.X_WO, last.V_WO, [way, way + step])
    return X, np.exp(-gap / slowing) / step * pose_error(X, after)


def _by_middle(before: FieldTrack, view: ObjectView) -> FieldTrack:
    """Without a model: the center of the visible points is the origin of O.

    Not so where the image ends within the object.
    """
    # Before there is a model: how far the center of the visible points moves by itself, as another
    # part of the object is seen [m].
    middle_error = 4e-3
    expected = before.estimate
    assert expected is not None
    if len(view.points_W) < FIRST_POINTS or view.at_border.any():
        return replace(before, in_view=0.0)
    information = np.diag(np.repeat([0.0, middle_error**-2], 3))
    P = expected.pose_covariance
    error = np.median(view.points_W, axis=0) - expected.X_WO[:3, 3]
    step = np.linalg.solve(np.linalg.inv(P) + information, information[:, 3:] @ error)
    estimate = expected.measured(moved(expected.X_WO, step), information)
    return replace(
        before,
        measured=estimate,
        estimate=estimate,
        deviation=middle_error,
        information=information,
    )


def _one_view(information: Array, views: int) -> Array:
    """How far a model may have moved with the view that was merged last: covariance, (6, 6).

    A view errs by the covariance of its image, with this information (6, 6), and all that is
    measured by the model of so many views errs with it. A filter without it takes the error for a
    motion.
    """
    # A merged view moves the model by its own error, as one of the views merged, and by this share
    # of it at least: where it shows another side it is the only one.
    share = max(1.0 / max(views, 1), 0.2)
    # What is known without any image of where a model is: standard deviations [rad, m].
    least = np.diag(1.0 / np.square(np.repeat((0.3, 0.03), 3)))
    return np.asarray(share**2 * np.linalg.inv(information + least))


def _located(
    before: FieldTrack, view: ObjectView, gap: float
) -> tuple[FieldTrack, Registration | None]:
    """What is known after a view, ``gap`` [s] after the last pose, and how the view fits.

    ``before`` is what is expected at the time of the view. It and None come back where the view
    gives no pose, but with the time of a search.
    """
    # After so long without a pose the object is searched for from several starts, and again so much
    # later [s].
    search_after, search_period = 0.25, 0.2
    # Least points of a view; a pose this far from the expected one is asked for as much as one that
    # was searched for [m].
    least_points, large_step = 30, 0.01
    model, expected, last = before.model, before.estimate, before.measured
    if model is None or expected is None or last is None or len(view.points_W) < least_points:
        return before, None
    time = before.image_time
    found = registered(model, view, expected.X_WO, expected.pose_covariance)
    near = np.linalg.norm(found.X_WO[:3, 3] - expected.X_WO[:3, 3]) <= large_step
    good = is_accepted(found) if near else is_found(found)
    good = good and (gap < _LONG_GAP or shows_model(found))
    may_search = gap > search_after and time >= before.searched_at + search_period
    if not good and may_search and len(view.points_W) >= FIRST_POINTS:
        before = replace(before, searched_at=time)
        # Start poses: the filter's prediction, and the last twist extrapolated.
        any_orientation = round(1e3 * abs(time)) if gap > _LONG_GAP else None
        # Standard deviation that a gap adds to the predicted pose [rad, m]; the second is after a
        # long one, in which the object may have turned to any side.
        sigma = (0.3, 0.05) if any_orientation is None else (1.5, 0.1)
        wide, on = expected.widened(np.diag(np.square(np.repeat(sigma, 3)))), last.pose(time)
        found = reacquire(
            model, view, (wide.X_WO, on), wide.pose_covariance, any_orientation=any_orientation
        )
        good = is_found(found, any_orientation=any_orientation is not None)
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
    """The first view defines O.

    One that is begun anew is turned as the old one was expected to be: what others have still
    received of that one, such as its grasps, is near where it was on the object.
    """
    if len(view.points_W) < FIRST_POINTS:
        return replace(before, image_time=time)
    R_WO = np.eye(3) if before.estimate is None else before.estimate.X_WO[:3, :3]
    X_WO = se3.make_pose(R_WO, np.median(view.points_W, axis=0))
    estimate = TwistFilter.at_rest(time, X_WO)
    return _passed_on(
        FieldTrack(
            image_time=time,
            X_WC=view.X_WC,
            measured=estimate,
            estimate=estimate,
            in_view=1.0,
            deviation=0.0,
            keyframe=outlined(keyframe_of(view, X_WO, time, begun_at=time), view, X_WO),
            cut=cut_off(np.zeros((0, 3)), view, X_WO),
            begun_at=time,
        )
    )


def _passed_on(track: FieldTrack) -> FieldTrack:
    """With the pose taken in by the filter that predicts."""
    assert track.estimate is not None
    motion = track.motion.copy()
    # What the tracked path is worth to the predictor of the motion [m, rad].
    noise = Noise(1.5e-3, 8e-3, jerk=JERK)
    measure_kernel(motion, track.image_time, np.array(track.estimate.X_WO), noise)
    seen = track.measured_at == track.image_time
    return replace(track, motion=motion, measured_motion=motion if seen else track.measured_motion)


@dataclass(frozen=True, eq=False)
class LearntShape(Frozen):
    """Shape merged from the keyframes.

    Attributes:
        cloud: The merged keyframes, in O.
        gpdf: The field fitted to them; None before the first.
        views: From where they were taken.
        looked: Time of the last keyframe, whether it could be used or not [s].
        outliers: Points of the merged views that were dropped as outliers.
        faults: How many keyframes could not be used, by `ViewFault`.
    """

    cloud: FusedCloud = field(default_factory=lambda: FusedCloud.empty(0.003, smooth=True))
    gpdf: Gpdf | None = None
    views: ViewRecord = field(default_factory=ViewRecord)
    looked: float = -np.inf
    outliers: int = 0
    faults: Counter[ViewFault] = field(default_factory=Counter)

    def merged(self, keyframe: Keyframe | None, **options: Any) -> "LearntShape":
        """With a tracker's last keyframe, if it is a new one, and if a field comes of it.

        A keyframe in a frame O that was begun anew is the first: what was there is forgotten. The
        options are those of `complete_shape`.
        """
        if keyframe is None or keyframe.time <= self.looked:
            return self
        looked = replace(self, looked=keyframe.time)
        before = self
        if not self.is_of(keyframe):
            nothing = FusedCloud.empty(self.cloud.voxel_size, smooth=self.cloud.smooth)
            before = replace(self, cloud=nothing, gpdf=None, views=ViewRecord(), outliers=0)
        points, known = keyframe.points_O, before.cloud.points
        # Fewer points are no view to merge.
        kept, fault, _ = usable_points(points, keyframe.p_OC, 64, known)
        if fault is not None:
            return replace(looked, faults=self.faults + Counter([fault]))
        # The tracker has registered it to this very cloud; merging must not move O.
        cloud = before.cloud.merged(
            *(kept, keyframe.p_OC),
            register=False,
            outline=keyframe.outline,
            deviation=keyframe.deviation,
        )
        try:
            gpdf = complete_shape(cloud, **options)
        # Whatever numerics make of a strange cloud (LinAlgError is a ValueError).
        except (ValueError, ArithmeticError):
            return replace(looked, faults=self.faults + Counter([ViewFault.NO_FIELD]))
        return replace(
            looked,
            cloud=cloud,
            gpdf=gpdf,
            views=before.views.extended(keyframe.p_OC, keyframe.time),
            outliers=before.outliers + len(keyframe.points_O) - len(kept),
        )

    def is_of(self, keyframe: Keyframe) -> bool:
        """Whether what has been merged is in the frame O of a keyframe."""
        return not len(self.views.times) or keyframe.begun_at <= self.views.times[0]


@dataclass(frozen=True, eq=False)
class SequenceTracker(Frozen):
    """A tracker and what it has learnt, image by image.

    Attributes:
        track: The tracker.
        shape: The shape it tracks by.
    """

    track: FieldTrack = field(default_factory=FieldTrack)
    shape: LearntShape = field(default_factory=LearntShape)

    def __post_init__(self) -> None:
        check_fields(self)

    @checked()
    def looked(self, view: ObjectView, time: float) -> "SequenceTracker":
        """Takes in an image; its keyframe is not merged yet, see `learnt`."""
        gpdf, views, looked = self.shape.gpdf, self.shape.views, self.shape.looked
        return replace(self, track=track(self.track, view, time, gpdf, views, looked=looked))

    def learnt(self) -> "SequenceTracker":
        """With the last keyframe merged, if it is not already."""
        # Points that the field is fitted to: what there is time for ten times a second.
        shape = self.shape.merged(self.track.keyframe, max_points=320)
        return self if shape is self.shape else replace(self, shape=shape)
