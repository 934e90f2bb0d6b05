"""Tracking of the object: configuration, error model of motion capture, state of a tracker."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.choices import SEED, key, word
from feasigrasp.models.geometry import se3


class TrackerKind(StrEnum):
    """Source of the object's pose."""

    MOCAP = "mocap"
    CAMERA = "camera"


@dataclass
class TrackerConfig:
    """A tracker, by default a perfect motion-capture system.

    Attributes:
        kind: ``mocap``, to which all keys but ``image_period`` belong, or ``camera``, with
            ``image_period`` and ``silence``: the object is tracked by its own distance field in the
            depth images that perception looks at, in the frame of its first view.
        image_period: Time between the images that a camera tracks in [s].
        period: Time between measurements [s].
        latency: Age of a measurement when it arrives [s], rounded to periods.
        position_noise: Standard deviation [m].
        rotation_noise: Standard deviation [rad].
        dropout: Probability that a measurement is lost.
        silence: The object is lost when measurements have been missing this long [s]: its pose is
            held, nothing is grasped, and the arm waits, or looks for it with the camera that it
            is tracked with.
        jerk: How quickly the object's acceleration is expected to change, see
            `feasigrasp.models.objects.pose_filter.Noise`: lower is smoother, higher follows sooner.
        angular_jerk: The same for its angular acceleration.
        seed: Seed of noise and losses.
    """

    kind: str = word(TrackerKind.MOCAP, TrackerKind)
    image_period: float = key(1.0 / 30.0, 0.005, 1.0, "s")
    period: float = key(0.005, 0.0001, 1.0, "s")
    latency: float = key(0.0, 0.0, 2.0, "s")
    position_noise: float = key(0.0, 0.0, 0.1, "m")
    rotation_noise: float = key(0.0, 0.0, 1.0, "rad")
    dropout: float = key(0.0, 0.0, 1.0)
    silence: float = key(0.5, 0.01, 60.0, "s")
    jerk: float = key(0.4, 0.0001, 10000.0)
    angular_jerk: float = key(0.3, 0.0001, 10000.0)
    seed: int = key(0, *SEED)


def measured_pose(X_WO: Array, time: float, config: TrackerConfig) -> Array | None:
    """Measurement of the true pose X_WO (4, 4) by motion capture; None for a lost one.

    The errors depend on the time [s] and on the seed only.
    """
    if max(config.position_noise, config.rotation_noise, config.dropout) == 0.0:
        return X_WO
    rng = np.random.default_rng([config.seed, round(time / config.period)])
    lost = rng.random() < config.dropout
    noise = rng.standard_normal(6)
    X = X_WO.copy()
    X[:3, :3] = se3.so3_exp(config.rotation_noise * noise[:3]) @ X[:3, :3]
    X[:3, 3] += config.position_noise * noise[3:]
    return None if lost else X


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
            return cls(TrackingState.SEARCHING, age, jumping)
        if age >= silence:
            return cls(TrackingState.LOST, age, jumping)
        late = age > COASTING_AFTER
        return cls(TrackingState.COASTING if late else TrackingState.TRACKING, age, jumping)

    @property
    def lost(self) -> bool:
        """Whether there is no pose to go by."""
        return self.state in (TrackingState.SEARCHING, TrackingState.LOST)
