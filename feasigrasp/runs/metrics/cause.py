"""Failure cause of a run without grasp success."""

from collections.abc import Mapping
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


def cause_of(
    samples: Mapping[str, Array],
    truth: ObjectTruth | None = None,
    pushed_mm: float | None = None,
    slip: tuple[float, float] = (0.0, 0.0),
) -> Cause:
    """Failure cause of a run without grasp success; rules in ``docs/results_schema.md``.

    Args:
        samples: By name, one or more, see `feasigrasp.systems.metrics.SAMPLE_NAMES`; grasps that
            are not recorded (NaN) count as found.
        truth: What happened to the object; None if not measured.
        pushed_mm: How far it was pushed before the fingers closed [mm]; None likewise.
        slip: Largest displacement [m] and rotation [rad] in the hand since it was let go.
    """
    phase = samples["phase"]
    released = bool(np.any(phase > Phase.CLOSE))
    opened_again = np.any((phase[:-1] == Phase.CLOSE) & (phase[1:] == Phase.APPROACH))
    sampled, reachable = (samples[name].any() for name in ("sampled_grasps", "reachable_grasps"))
    applies = {
        Cause.BROKE_OFF: truth is not None and truth.broke_off,
        # No view ever became a field.
        Cause.NOTHING_SEEN: np.isnan(samples["view_age"][-1]) and not sampled,
        Cause.NO_GRASP: not sampled,
        Cause.NONE_REACHABLE: not reachable,
        Cause.PUSHED_AWAY: not released and (pushed_mm or 0.0) > PUSHED_AWAY,
        Cause.NEVER_SETTLED: not np.any(phase >= Phase.CLOSE),
        Cause.MISSED: not released and opened_again,
        Cause.DROPPED: released and not (truth is not None and truth.touched),
        Cause.OUT_OF_TIME: phase[-1] != Phase.DONE,
        Cause.SLIPPED: slip[0] >= HELD_DISTANCE or slip[1] >= HELD_ANGLE,
        Cause.NOT_LIFTED: True,
    }
    return next(cause for cause in Cause if applies[cause])
