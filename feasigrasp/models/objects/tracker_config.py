"""Configuration of the object tracker, and the error model of motion capture."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from feasigrasp.models.arrays import Array
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
