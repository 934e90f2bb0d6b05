"""Interface of trackers on recordings, and our tracker behind it."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.objects.prediction import MotionEstimate
from feasigrasp.models.tracking.sequence import SequenceTracker
from feasigrasp.models.tracking.view import ObjectView


class Tracker(Protocol):
    """What plays a recording: a tracker, or a peer."""

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image."""

    def learnt(self) -> bool:
        """Merges the last view if it is informative; returns whether it did."""

    @property
    def X_WO(self) -> Array | None:
        """The pose now, shape (4, 4); None before the first view."""

    @property
    def V_WO(self) -> Array:
        """The twist now, shape (6,)."""

    def predicted(self, time: float, ahead: float) -> Array:
        """The pose ``ahead`` seconds after now, shape (4, 4)."""

    @property
    def measured(self) -> bool:
        """Whether the last image gave a pose."""


class OurTracker:
    """`SequenceTracker`, image by image."""

    def __init__(self) -> None:
        self._now = SequenceTracker()

    def looked(self, view: ObjectView, time: float) -> None:
        """Takes in an image."""
        self._now = self._now.looked(view, time)

    def learnt(self) -> bool:
        """Merges a keyframe, if there is a new one."""
        before, self._now = self._now, self._now.learnt()
        return self._now is not before

    @property
    def X_WO(self) -> Array | None:
        """The pose at the time of the last image."""
        estimate = self._now.track.estimate
        return None if estimate is None else estimate.X_WO

    @property
    def V_WO(self) -> Array:
        """The twist."""
        estimate = self._now.track.estimate
        return np.zeros(6) if estimate is None else estimate.V_WO

    def predicted(self, time: float, ahead: float) -> Array:
        """As the motion of the last seconds goes on."""
        track = self._now.track
        X_WO = None if track.estimate is None else track.estimate.pose(time)
        X: Array = MotionEstimate(track.motion, time, X_WO).predict([ahead])[0]
        return X

    @property
    def measured(self) -> bool:
        """Whether the last image gave a pose."""
        return self._now.track.measured_at == self._now.track.image_time
