"""Tracks an object through a sequence of images, and learns its shape on the way; without Drake."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from feasigrasp.errors import PointCloudError
from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.usable import usable_points
from feasigrasp.models.clouds.view_record import ViewRecord
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.tracking.tracker import FieldTrack, Keyframe, track
from feasigrasp.models.tracking.view import ObjectView

#: Fewer points are no view to merge.
_LEAST_POINTS = 64


@dataclass(frozen=True, eq=False)
class LearntShape(Frozen):
    """What the keyframes have shown.

    Attributes:
        cloud: The merged keyframes, in O.
        gpdf: The field fitted to them; None before the first.
        views: From where they were taken.
    """

    cloud: FusedCloud = field(default_factory=lambda: FusedCloud.empty(0.003, smooth=True))
    gpdf: Gpdf | None = None
    views: ViewRecord = field(default_factory=ViewRecord)

    def merged(self, keyframe: Keyframe, max_points: int = 320) -> LearntShape:
        """With one more keyframe; without it if no field comes of it."""
        kept, fault, _ = usable_points(keyframe.points_O, keyframe.p_OC, _LEAST_POINTS)
        if fault is not None:
            return self
        cloud = self.cloud.merged(kept, keyframe.p_OC, register=False)
        try:
            gpdf = complete_shape(cloud, max_points=max_points)
        except (PointCloudError, ValueError, ArithmeticError):
            return self
        return LearntShape(cloud, gpdf, self.views.extended(keyframe.p_OC, keyframe.time))


@dataclass(frozen=True, eq=False)
class SequenceTracker(Frozen):
    """A tracker and what it has learnt, image by image.

    Attributes:
        track: The tracker.
        shape: The shape it tracks by.
    """

    track: FieldTrack = field(default_factory=FieldTrack)
    shape: LearntShape = field(default_factory=LearntShape)

    def looked(self, view: ObjectView, time: float) -> SequenceTracker:
        """Takes in an image; its keyframe is not merged yet, see `learnt`."""
        return replace(self, track=track(self.track, view, time, self.shape.gpdf, self.shape.views))

    def learnt(self) -> SequenceTracker:
        """With the last keyframe merged, if it is not already."""
        keyframe, times = self.track.keyframe, self.shape.views.times
        if keyframe is None or (len(times) and keyframe.time <= times[-1]):
            return self
        return replace(self, shape=self.shape.merged(keyframe))
