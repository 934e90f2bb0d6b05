"""The names of controllers and of their modes."""

from enum import StrEnum

from feasigrasp.plugins import plugins

#: The mode of this package: limits and clearances are enforced.
SAFE = "safe"


class ControlSpace(StrEnum):
    """Where a controller follows grasps: as poses of the hand, or as configurations of the arm."""

    TASK = "task"
    JOINT = "joint"


def controller_names() -> list[str]:
    """What ``control.controller`` may be: our controllers, and those that packages add."""
    return [*ControlSpace, *plugins("controllers")]


def mode_names() -> list[str]:
    """What ``control.mode`` may be: ours, and those that packages add."""
    return [SAFE, *plugins("modes")]
