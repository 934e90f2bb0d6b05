"""Faults of the measured object pose."""

import math
from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.fault import Fault, number, vector
from feasigrasp.models.geometry import se3


@dataclass
class PoseFault(Fault):
    """A fault of the measured pose; derive from it."""

    def depth(self, period: float) -> int:
        """Number of earlier measurements, ``period`` [s] apart, that the fault needs."""
        return 1

    def remembered(self, t: float, past: Array, X_WO: Array) -> Array:
        """Stored measurements after one at time t, newest first, shape (k, 4, 4)."""
        return np.concatenate([X_WO[None], past[:-1]])

    def measured(self, X_WO: Array, past: Array, rng: np.random.Generator) -> Array:
        """The faulty measurement.

        Args:
            X_WO: The pose that would have been measured, shape (4, 4).
            past: Those before, newest first; NaN where there was none, shape (k, 4, 4).
            rng: What is random is drawn from it.
        """
        raise NotImplementedError


@dataclass
class PoseFrozen(PoseFault):
    """The last pose comes again and again, bit for bit."""

    def remembered(self, t: float, past: Array, X_WO: Array) -> Array:
        """Nothing new while it is frozen; at the very start, the pose then."""
        fresh = not self.active(t) or np.isnan(past[0, 0, 0])
        return X_WO[None] if fresh else past

    def measured(self, X_WO: Array, past: Array, rng: np.random.Generator) -> Array:
        """The last pose before."""
        return X_WO if np.isnan(past[0, 0, 0]) else past[0]


@dataclass
class PoseJump(PoseFault):
    """A constant offset of the measured pose.

    Attributes:
        by: How far off, in the world [m].
        turn_deg: How far turned about the object's origin [deg]; 180 flips it.
        axis: Axis of that turn, in the object's frame.
    """

    by: list[float] = vector([0.1, 0.0, 0.0], -10.0, 10.0)
    turn_deg: float = number(30.0, -360.0, 360.0)
    axis: list[float] = vector([1.0, 0.0, 0.0], -1.0, 1.0)

    def measured(self, X_WO: Array, past: Array, rng: np.random.Generator) -> Array:
        """The pose, turned and moved."""
        axis = np.asarray(self.axis) / max(float(np.linalg.norm(self.axis)), 1e-12)
        result = X_WO.copy()
        result[:3, :3] = X_WO[:3, :3] @ se3.so3_exp(math.radians(self.turn_deg) * axis)
        result[:3, 3] += self.by
        return result


@dataclass
class PoseNan(PoseFault):
    """No pose is measured; what comes is not a number."""

    def measured(self, X_WO: Array, past: Array, rng: np.random.Generator) -> Array:
        """NaN in every entry."""
        return np.full((4, 4), np.nan)


@dataclass
class PoseLate(PoseFault):
    """Delayed and noisy poses, without a change of the tracker's noise model.

    What is always so, and known, belongs into the scenario's ``tracker``: ``latency``,
    ``position_noise`` and ``rotation_noise``.

    Attributes:
        delay: Their age [s].
        position_noise: Standard deviation along each axis [m].
        rotation_noise_deg: The same about each axis [deg].
    """

    delay: float = number(0.1, 0.0, 10.0)
    position_noise: float = number(0.005, 0.0, 1.0)
    rotation_noise_deg: float = number(3.0, 0.0, 180.0)

    def depth(self, period: float) -> int:
        """Number of periods in the delay."""
        return max(1, round(self.delay / period))

    def measured(self, X_WO: Array, past: Array, rng: np.random.Generator) -> Array:
        """The oldest pose that is remembered, with noise; NaN if there is none yet."""
        result = (X_WO if self.delay == 0.0 else past[-1]).copy()
        noise = rng.standard_normal(6)
        turn = math.radians(self.rotation_noise_deg) * noise[:3]
        result[:3, :3] = se3.so3_exp(turn) @ result[:3, :3]
        result[:3, 3] += self.position_noise * noise[3:]
        return result
