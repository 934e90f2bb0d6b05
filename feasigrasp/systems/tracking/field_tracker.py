"""Tracks an object with the robot's own camera, by its distance field."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.perception import PointCloud
from pydrake.systems.framework import Context, LeafSystem
from pydrake.systems.sensors import ImageDepth32F

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.camera import Camera
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.models.objects.pose_filter import empty_state
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.objects.tracking import TrackerConfig, Tracking, TrackingState
from feasigrasp.models.tracking.tracker import FieldTrack, track
from feasigrasp.models.tracking.view import ObjectView
from feasigrasp.systems.point_cloud_to_gpdf import Perceived
from feasigrasp.systems.ports import PeriodicState, declare_input, declare_output, scalar


class FieldTracker(LeafSystem):
    """Pose and twist of an unknown object, from depth images of it; a drop-in for `ObjectTracker`.

    .. pydrake_system::

        name: FieldTracker
        input_ports: [point_cloud, camera_pose, depth_image, image_time, perceived, phase, track,
          second_point_cloud, second_camera_pose, second_depth_image, second_image_time]
        output_ports: [object_pose, object_velocity, object_motion, tracking, keyframe,
          pose_at_view, stamp, track]

    ``point_cloud`` shows the object only, in the world frame; ``camera_pose`` X_WC is that at which
    it was taken, ``depth_image`` the whole image that it is a part of, from which the tracker
    computes where the object is not. ``image_time`` is when it was taken [s] (V1). The last two are
    optional; without a time an image is taken when it is read. ``perceived`` is a `Perceived`, from
    `KeyframesToGPDF`: the field by which is tracked. ``phase`` (V1, see `GripperSequencer`), of a
    gripper that carries the camera, is optional: what it lifts moves with it.

    The ports that begin with ``second`` are there if there is a second camera, and optional. Its
    images are looked at while those of the first do not show the object: poses come of them, and no
    keyframes.

    ``track`` is a `FieldTrack`, the tracker's state; where the input of that name is connected,
    such as to a tracker in another process, images are left to that one, and not read here.

    The first four outputs are those of `ObjectTracker`. The frame O is that of the first view: its
    origin is the center of the visible points, its axes are the world's. ``keyframe`` is the last
    `Keyframe`, a view worth merging; None before the first. ``pose_at_view`` is where the object is
    expected at ``image_time``, before that image has been looked at; ``stamp`` (V1) is when the
    last one that has been was taken [s], -inf before. Images are read every ``image_period``. The
    filter's state is of their exposure, and the other outputs are predicted from it to the present:
    over the delay of the images, between them, and while the object is out of sight. After
    ``silence`` without a pose the object is lost; it is still looked for.
    """

    def __init__(
        self, camera: Camera, config: TrackerConfig | None = None, second: Camera | None = None
    ) -> None:
        """A tracker of what ``camera`` sees, and ``second`` where that does not show the object."""
        super().__init__()
        self._config, self._first = config or TrackerConfig(), _Images(self, camera)
        self._perceived = declare_input(self, "perceived", kind=Perceived | None)
        self._phase = self.DeclareVectorInputPort("phase", 1)
        self._given = declare_input(self, "track", kind=FieldTrack | None)
        self._second = None if second is None else _Images(self, second, "second_")
        self._track = PeriodicState(self, FieldTrack(), self._config.image_period, self._look)
        state = {self._track, self._given}
        now = {*state, self.time_ticket()}
        declare_output(self, "object_pose", self._calc_pose, now, model=RigidTransform())
        declare_output(
            self, "object_velocity", self._calc_velocity, now, model=SpatialVelocity.Zero()
        )
        declare_output(self, "object_motion", self._calc_motion, now)
        declare_output(self, "tracking", self.tracking, now)
        declare_output(self, "keyframe", lambda context: self._known(context).keyframe, state)
        at_view = {*now, self._first.stamp}
        declare_output(self, "pose_at_view", self._calc_at_view, at_view, model=RigidTransform())
        known = self._known
        declare_output(self, "stamp", lambda context: known(context).image_time, state, size=1)
        # Others do not need the shape that it tracks by, and it is large.
        declare_output(self, "track", lambda context: replace(known(context), model=None), state)

    def tracking(self, context: Context) -> Tracking:
        """Quality of the pose at present."""
        found = self._known(context)
        state = found.state(context.get_time(), self._config.silence)
        if found.estimate is None:
            return Tracking(state, np.inf, in_view=0.0, deviation=np.inf)
        return Tracking(
            state,
            max(0.0, found.age(context.get_time()) - self._config.image_period),
            in_view=found.in_view,
            deviation=found.deviation,
            covariance=found.estimate.pose_covariance,
            expected=self._expected(found, state, context.get_time()),
        )

    def _known(self, context: Context) -> FieldTrack:
        """The track of this tracker, or the one at its input."""
        return (self._given if self._given.HasValue(context) else self._track).Eval(context)

    def _look(self, context: Context) -> FieldTrack:
        before = self._known(context)
        if self._given.HasValue(context):
            return before
        time = self._first.time(context)
        if not time > before.image_time:  # nor before the first image, whose time is not a number
            return before
        perceived: Any = self._perceived.Eval(context)
        held = scalar(self._phase, context, Phase.APPROACH) > Phase.CLOSE
        second = partial(self._second.view_at, context, time) if self._second is not None else None
        learnt = {"gpdf": perceived.gpdf, "views": perceived.views, "looked": perceived.looked}
        view = self._first.view(context)
        after = track(before, view, time, **learnt, held=held, second=second)
        return replace(after, delay=context.get_time() - time)

    @staticmethod
    def _expected(found: FieldTrack, state: TrackingState, time: float) -> Array:
        """Pose at a time; held once the object is lost."""
        assert found.estimate is not None
        if state is TrackingState.LOST:
            return found.estimate.X_WO
        return found.estimate.pose(time, coasting=state is TrackingState.COASTING)

    def _calc_pose(self, context: Context) -> RigidTransform:
        return self._pose(context, context.get_time())

    def _calc_at_view(self, context: Context) -> RigidTransform:
        # Before the first image has come, its time is not a number.
        time = self._first.time(context)
        return self._pose(context, time if np.isfinite(time) else context.get_time())

    def _pose(self, context: Context, time: float) -> RigidTransform:
        found = self._known(context)
        if found.estimate is None:
            return RigidTransform(np.full((4, 4), np.nan))
        state = found.state(context.get_time(), self._config.silence)
        return RigidTransform(self._expected(found, state, time))

    def _calc_velocity(self, context: Context) -> SpatialVelocity:
        """Twist now; NaN before the first view, and none once the object is lost."""
        found, time = self._known(context), context.get_time()
        if found.estimate is None:
            return SpatialVelocity(np.full(6, np.nan))
        state = found.state(time, self._config.silence)
        if state is TrackingState.LOST:
            return SpatialVelocity.Zero()
        V_WO = found.estimate.twist(time, coasting=state is TrackingState.COASTING)
        if state is TrackingState.TRACKING:  # by its path with less noise than by the last images
            X_WO = self._expected(found, state, time)
            V_WO[3:] = MotionEstimate(found.motion, time, X_WO).velocity(V_WO[3:])
        return SpatialVelocity(V_WO)

    def _calc_motion(self, context: Context) -> MotionEstimate:
        tracking, time = self.tracking(context), context.get_time()
        motion = empty_state() if tracking.lost else self._known(context).motion.copy()
        return MotionEstimate(motion, time, tracking.expected)


class _Images:
    """The ports of a camera's images; their names begin with ``prefix``."""

    def __init__(self, tracker: LeafSystem, camera: Camera, prefix: str = "") -> None:
        self._camera = camera
        self._cloud = declare_input(tracker, f"{prefix}point_cloud", PointCloud())
        self._camera_pose = declare_input(tracker, f"{prefix}camera_pose", RigidTransform())
        self._depth = declare_input(tracker, f"{prefix}depth_image", ImageDepth32F(1, 1))
        self.stamp = tracker.DeclareVectorInputPort(f"{prefix}image_time", 1)

    def time(self, context: Context) -> float:
        """When the present image was taken [s]; now if nothing says so."""
        return scalar(self.stamp, context, context.get_time())

    def view(self, context: Context) -> ObjectView:
        """What the present image shows."""
        xyz = self._cloud.Eval(context).xyzs().T
        points = np.asarray(xyz[np.isfinite(xyz).all(axis=1)], dtype=float)
        depth = self._depth.Eval(context).data[:, :, 0] if self._depth.HasValue(context) else None
        X_WC = self._camera_pose.Eval(context).GetAsMatrix4()
        return ObjectView(self._camera, X_WC, points, depth)

    def view_at(self, context: Context, time: float) -> ObjectView | None:
        """What it saw at a time; None if it saw nothing within 20 ms of it."""
        if self.stamp.HasValue(context) and not abs(self.time(context) - time) <= 0.02:
            return None
        return self.view(context) if self._cloud.HasValue(context) else None
