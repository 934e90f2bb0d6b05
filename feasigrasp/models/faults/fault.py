"""Base class of fault models: active interval and value ranges."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from feasigrasp.errors import ScenarioError

#: An instant that is this little before the start belongs to the fault [s]: rounding of times.
_INSTANT = 1e-9


def number(default: float, low: float, high: float = math.inf) -> Any:
    """A field of a fault that holds a number from ``low`` to ``high``."""
    return field(default=default, metadata={"low": low, "high": high})


def vector(default: Sequence[float], low: float, high: float) -> Any:
    """A field of a fault that holds x, y and z, each from ``low`` to ``high``."""
    return field(default_factory=lambda: list(default), metadata={"low": low, "high": high})


@dataclass
class Fault:
    """Something that goes wrong for a while.

    Attributes:
        start: When it begins [s].
        duration: How long it lasts [s]; ``.inf`` for ever.
        every: It comes again this long after each beginning [s]; ``.inf`` for once only.
    """

    start: float = number(0.0, 0.0, 1e9)
    duration: float = number(math.inf, 0.0)
    every: float = number(math.inf, 0.0)

    def check(self, name: str) -> None:
        """Checks the values, which are set one by one when a scenario is read.

        Args:
            name: What the fault is called in a message, e.g. ``faults[0]``.

        Raises:
            ScenarioError: A value out of range, not a number, or a vector that is not x, y and z.
        """
        for entry in fields(self):
            value, low, high = getattr(self, entry.name), *map(entry.metadata.get, ("low", "high"))
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
