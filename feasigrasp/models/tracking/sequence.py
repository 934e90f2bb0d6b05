"""Tracks an object through an image sequence and refines its shape, without Drake."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Frozen
from feasigrasp.models.clouds.fusion import FusedCloud
from feasigrasp.models.clouds.usable import ViewFault, ViewRecord, usable_points
from feasigrasp.models.shape.completion import complete_shape
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.models.tracking.keyframe import Keyframe
from feasigrasp.models.tracking.tracker import FieldTrack, track
from feasigrasp.models.tracking.view import ObjectView


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

    def merged(self, keyframe: Keyframe | None, **options: Any) -> LearntShape:
        """With a tracker's last keyframe, if it is a new one, and if a field comes of it.

        A keyframe in a frame O that was begun anew is the first: what was there is forgotten. The
        options are those of `complete_shape`.
        """
        if keyframe is None or keyframe.time <= self.looked:
            return self
        looked = replace(self, looked=keyframe.time)
        before = self if self.is_of(keyframe) else self._forgotten()
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

    def _forgotten(self) -> LearntShape:
        nothing = FusedCloud.empty(self.cloud.voxel_size, smooth=self.cloud.smooth)
        return replace(self, cloud=nothing, gpdf=None, views=ViewRecord(), outliers=0)


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
    def looked(self, view: ObjectView, time: float) -> SequenceTracker:
        """Takes in an image; its keyframe is not merged yet, see `learnt`."""
        gpdf, views, looked = self.shape.gpdf, self.shape.views, self.shape.looked
        return replace(self, track=track(self.track, view, time, gpdf, views, looked=looked))

    def learnt(self) -> SequenceTracker:
        """With the last keyframe merged, if it is not already."""
        # Points that the field is fitted to: what there is time for ten times a second.
        shape = self.shape.merged(self.track.keyframe, max_points=320)
        return self if shape is self.shape else replace(self, shape=shape)
