"""Tracking state: age of the last measurement behind a pose."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from feasigrasp.models.arrays import Array, Frozen

#: A pose that rests on a measurement this much older than usual is extrapolated, no more [s].
#: Source: guessed.
COASTING_AFTER = 0.1


class TrackingState(StrEnum):
    """State of a tracker."""

    SEARCHING = "searching"
    TRACKING = "tracking"
    COASTING = "coasting"
    LOST = "lost"


@dataclass(frozen=True, eq=False)
class Tracking(Frozen):
    """Quality of a tracker's pose.

    ``searching``: there has been no measurement yet, and there is no pose. ``tracking``: the pose
    rests on what was measured just now. ``coasting``: it is extrapolated. ``lost``: it has been
    extrapolated for so long that it is held where it was, and good for nothing.

    Attributes:
        state: See above.
        age: How much older than usual the last measurement is [s]; infinite before the first.
        jumping: Whether measurements say that the object is somewhere else altogether, which is
            gated.
        in_view: Share of the known surface facing the camera that the last image showed; 1 for a
            tracker without a camera.
        deviation: Standard deviation of the surface across itself [m]; 0 if it is not known. What
            the shape does not determine, like the turn of a can, does not count.
        covariance: Of the pose's error [theta, p], see `feasigrasp.models.tracking.twist_filter`,
            shape (6, 6); None if it is not known.
        expected: X_WO by all that is known, shape (4, 4): a camera on the arm may be turned there.
            None before the object was seen, and for a tracker without a camera.
    """

    state: TrackingState
    age: float
    jumping: bool = False
    in_view: float = 1.0
    deviation: float = 0.0
    covariance: Array | None = None
    expected: Array | None = None

    @classmethod
    def of_age(cls, age: float, silence: float, jumping: bool = False) -> Self:
        """The state of a tracker at an age, see `Tracking`; lost from ``silence`` [s] on."""
        if age == float("inf"):
            state = TrackingState.SEARCHING
        elif age >= silence:
            state = TrackingState.LOST
        elif age > COASTING_AFTER:
            state = TrackingState.COASTING
        else:
            state = TrackingState.TRACKING
        return cls(state, age, jumping)

    @property
    def lost(self) -> bool:
        """Whether there is no pose to go by."""
        return self.state in (TrackingState.SEARCHING, TrackingState.LOST)
