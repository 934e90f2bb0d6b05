"""Faults of a scenario, by YAML tag.

For example, one pixel in twenty 5 cm off for five seconds, and no pose for half a second, again and
again::

    faults:
    - !Outliers {start: 2.0, duration: 5.0, share: 0.05, size: 0.05}
    - !PoseNan {start: 4.0, duration: 0.5, every: 3.0}
"""

import typing
from collections.abc import Sequence
from dataclasses import dataclass

from feasigrasp.errors import ScenarioError
from feasigrasp.models.faults import fault, images
from feasigrasp.models.faults import object as objects


@dataclass
class Untagged(fault.Fault):
    """A fault without a tag, which is rejected."""


AnyFault = typing.Union[  # noqa: UP007 - the form of Drake's own schema
    Untagged,
    images.CameraGone,
    images.CameraBlack,
    images.CameraFrozen,
    images.CameraMirrored,
    images.OnePlane,
    images.Outliers,
    images.MaskShifted,
    images.MaskEroded,
    images.MaskDilated,
    images.MaskWhole,
    images.MaskEmpty,
    fault.PoseFrozen,
    fault.PoseJump,
    fault.PoseNan,
    fault.PoseLate,
    fault.PerceptionLate,
    objects.ObjectPace,
    objects.ObjectMoved,
    objects.ObjectPulled,
    fault.CommandNan,
    fault.CommandWild,
    fault.SolverFailure,
]


def check_faults(faults: Sequence[fault.Fault]) -> None:
    """Raises a ScenarioError for a fault without a tag, or a value out of its range."""
    for index, each in enumerate(faults):
        if isinstance(each, Untagged):
            tags = ", ".join(f"!{kind.__name__}" for kind in typing.get_args(AnyFault)[1:])
            raise ScenarioError(f"faults[{index}] does not say what it is; give one of {tags}")
        each.check(f"faults[{index}]")
