"""Fault models: active interval and value ranges; faults of poses, fields and commands."""

import math
from dataclasses import dataclass, fields

import numpy as np

from feasigrasp.errors import ScenarioError
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import key
from feasigrasp.models.geometry import se3

#: An instant that is this little before the start belongs to the fault [s]: rounding of times.
#: Source: numerical.
_INSTANT = 1e-9


@dataclass
class Fault:
    """Something that goes wrong for a while.

    Attributes:
        start: When it begins [s].
        duration: How long it lasts [s]; ``.inf`` for ever.
        every: It comes again this long after each beginning [s]; ``.inf`` for once only.
    """

    start: float = key(0.0, 0.0, 1e9, "s")
    duration: float = key(math.inf, 0.0, math.inf, "s")
    every: float = key(math.inf, 0.0, math.inf, "s")

    def check(self, name: str) -> None:
        """Checks the values, which are set one by one when a scenario is read.

        Raises ScenarioError, which calls the fault by the name, e.g. ``faults[0]``, for a value out
        of range, or not a number, or a vector that is not x, y and z.
        """
        for entry in fields(self):
            value, (low, high, _) = getattr(self, entry.name), entry.metadata["span"]
            where = f"{name} (!{type(self).__name__}): {entry.name} is {value}"
            if isinstance(value, list) and len(value) != 3:
                raise ScenarioError(f"{where}; give x, y and z")
            if not np.all((np.asarray(value) >= low) & (np.asarray(value) <= high)):
                raise ScenarioError(f"{where}; give {low:g} to {high:g}")
        if math.isfinite(self.every) and not self.duration < self.every:
            raise ScenarioError(
                f"{name} (!{type(self).__name__}): every is {self.every}, but it lasts "
                f"{self.duration} s; give more than that, or leave it out"
            )

    def since(self, t: float) -> float:
        """Time since the last beginning [s]; negative before the first."""
        elapsed = t - self.start
        return math.fmod(elapsed + _INSTANT, self.every) - _INSTANT if elapsed > 0.0 else elapsed

    def active(self, t: float) -> bool:
        """Whether the fault is there at time t [s]."""
        return -_INSTANT <= self.since(t) < self.duration - _INSTANT


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
        """The faulty measurement, shape (4, 4), in place of ``X_WO``; what is random by ``rng``.

        ``past`` are those before, newest first; NaN where there was none, shape (k, 4, 4).
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

    by: list[float] = key([0.1, 0.0, 0.0], -10.0, 10.0, "m")
    turn_deg: float = key(30.0, -360.0, 360.0, "deg")
    axis: list[float] = key([1.0, 0.0, 0.0], -1.0, 1.0)

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

    delay: float = key(0.1, 0.0, 10.0, "s")
    position_noise: float = key(0.005, 0.0, 1.0, "m")
    rotation_noise_deg: float = key(3.0, 0.0, 180.0, "deg")

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


@dataclass
class PerceptionLate(Fault):
    """Perception with a delay beyond ``perception.latency``.

    Attributes:
        delay: How late [s].
    """

    delay: float = key(1.5, 0.0, 100.0, "s")


@dataclass
class CommandFault(Fault):
    """A fault of the velocity that the controller commands; derive from it."""

    def command(self, qd: Array, rng: np.random.Generator) -> Array:
        """The faulty command in place of ``qd`` [rad/s], shape (7,)."""
        raise NotImplementedError


@dataclass
class CommandNan(CommandFault):
    """The command is not a number."""

    def command(self, qd: Array, rng: np.random.Generator) -> Array:
        """NaN for every joint."""
        return np.full_like(qd, np.nan)


@dataclass
class CommandWild(CommandFault):
    """Random joint velocities far beyond the limits, drawn at every tick.

    Attributes:
        speed: How fast [rad/s].
    """

    speed: float = key(1e6, 0.0, math.inf, "rad/s")

    def command(self, qd: Array, rng: np.random.Generator) -> Array:
        """The speed with signs that are drawn."""
        return rng.choice([-self.speed, self.speed], len(qd))


@dataclass
class SolverFailure(Fault):
    """The solver of the safety QP gives up, whatever it is asked, and its answer is NaN."""
