"""Faults of a scenario, by YAML tag.

For example, one pixel in twenty 5 cm off for five seconds, and no pose for half a second, again and
again::

    faults:
    - !Outliers {start: 2.0, duration: 5.0, share: 0.05, size: 0.05}
    - !PoseNan {start: 4.0, duration: 0.5, every: 3.0}
"""

import math
import typing
from collections.abc import Sequence
from dataclasses import dataclass

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults.fault import (
    CommandNan,
    CommandWild,
    Fault,
    PerceptionLate,
    PoseFrozen,
    PoseJump,
    PoseLate,
    PoseNan,
    SolverFailure,
)
from feasigrasp.models.faults.images import (
    CameraBlack,
    CameraFrozen,
    CameraGone,
    CameraMirrored,
    MaskDilated,
    MaskEmpty,
    MaskEroded,
    MaskShifted,
    MaskWhole,
    OnePlane,
    Outliers,
)
from feasigrasp.models.faults.object import ObjectMoved, ObjectPace, ObjectPulled


@dataclass
class Untagged:
    """A fault without a tag, which is rejected."""

    start: float = 0.0
    duration: float = math.inf
    every: float = math.inf


AnyFault = typing.Union[  # noqa: UP007 - the form of Drake's own schema
    Untagged,
    CameraGone,
    CameraBlack,
    CameraFrozen,
    CameraMirrored,
    OnePlane,
    Outliers,
    MaskShifted,
    MaskEroded,
    MaskDilated,
    MaskWhole,
    MaskEmpty,
    PoseFrozen,
    PoseJump,
    PoseNan,
    PoseLate,
    PerceptionLate,
    ObjectPace,
    ObjectMoved,
    ObjectPulled,
    CommandNan,
    CommandWild,
    SolverFailure,
]


def check_faults(faults: Sequence[Fault | Untagged]) -> None:
    """Raises a ScenarioError for a fault without a tag, or a value out of its range."""
    for index, fault in enumerate(faults):
        if isinstance(fault, Untagged):
            tags = ", ".join(f"!{kind.__name__}" for kind in typing.get_args(AnyFault)[1:])
            raise ScenarioError(f"faults[{index}] does not say what it is; give one of {tags}")
        fault.check(f"faults[{index}]")
