"""Failure cause of a run without grasp success."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.grasps.sequence import Phase
from feasigrasp.runs.metrics.handling import HELD_ANGLE, HELD_DISTANCE, ObjectTruth

#: An object that was pushed farther than this off its path has been pushed away [mm]. Source:
#: definition.
PUSHED_AWAY = 50.0


class Cause(StrEnum):
    """Failure cause of a run; the first in this order that applies."""

    BROKE_OFF = "broke_off"
    NOTHING_SEEN = "nothing_seen"
    NO_GRASP = "no_grasp"
    NONE_REACHABLE = "none_reachable"
    PUSHED_AWAY = "pushed_away"
    NEVER_SETTLED = "never_settled"
    MISSED = "missed"
    DROPPED = "dropped"
    OUT_OF_TIME = "out_of_time"
    SLIPPED = "slipped"
    NOT_LIFTED = "not_lifted"


@dataclass(frozen=True, eq=False)
class Course:
    """Data of a run for the classification of failures.

    Attributes:
        samples: By name, the samples of the run, see `feasigrasp.systems.metrics.SAMPLE_NAMES`.
        truth: What happened to the object; None if not measured.
        pushed_mm: How far it was pushed before the fingers closed [mm]; None likewise.
        slip: Largest displacement [m] and rotation [rad] in the hand since it was let go.
    """

    samples: Mapping[str, Array]
    truth: ObjectTruth | None = None
    pushed_mm: float | None = None
    slip: tuple[float, float] = (0.0, 0.0)

    @property
    def phase(self) -> Array:
        """The `Phase` of every sample."""
        return self.samples["phase"]

    def had(self, grasps: str) -> bool:
        """Whether there ever were ``grasps``, or they are not recorded (NaN)."""
        return bool(self.samples[grasps].any())

    @property
    def touched(self) -> bool:
        """Whether arm or hand touched the object at the end."""
        return self.truth is not None and self.truth.touched

    @property
    def released(self) -> bool:
        """Whether the object was let go."""
        return bool(np.any(self.phase > Phase.CLOSE))


def _opened_again(run: Course) -> bool:
    closing = run.phase == Phase.CLOSE
    return bool(np.any(closing[:-1] & (run.phase[1:] == Phase.APPROACH)))


_RULES: dict[Cause, Callable[[Course], bool]] = {
    Cause.BROKE_OFF: lambda run: run.truth is not None and run.truth.broke_off,
    # No view ever became a field.
    Cause.NOTHING_SEEN: lambda run: bool(
        np.isnan(run.samples["view_age"][-1]) and not run.had("sampled_grasps")
    ),
    Cause.NO_GRASP: lambda run: not run.had("sampled_grasps"),
    Cause.NONE_REACHABLE: lambda run: not run.had("reachable_grasps"),
    Cause.PUSHED_AWAY: lambda run: not run.released and (run.pushed_mm or 0.0) > PUSHED_AWAY,
    Cause.NEVER_SETTLED: lambda run: not np.any(run.phase >= Phase.CLOSE),
    Cause.MISSED: lambda run: not run.released and _opened_again(run),
    Cause.DROPPED: lambda run: run.released and not run.touched,
    Cause.OUT_OF_TIME: lambda run: run.phase[-1] != Phase.DONE,
    Cause.SLIPPED: lambda run: run.slip[0] >= HELD_DISTANCE or run.slip[1] >= HELD_ANGLE,
    Cause.NOT_LIFTED: lambda run: True,
}


def cause_of(run: Course) -> Cause:
    """Failure cause of a run without grasp success; rules in ``docs/results_schema.md``."""
    return next(cause for cause in Cause if _RULES[cause](run))
