"""Faults of computation: delayed distance fields and wrong commands."""

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.faults.fault import Fault, number


@dataclass
class PerceptionLate(Fault):
    """Perception with a delay beyond ``perception.latency``.

    Attributes:
        delay: How late [s].
    """

    delay: float = number(1.5, 0.0, 100.0)


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

    speed: float = number(1e6, 0.0)

    def command(self, qd: Array, rng: np.random.Generator) -> Array:
        """The speed with signs that are drawn."""
        return rng.choice([-self.speed, self.speed], len(qd))


@dataclass
class SolverFailure(Fault):
    """The solver of the safety QP gives up, whatever it is asked, and its answer is NaN."""
