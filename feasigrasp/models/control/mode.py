"""Names of controllers and of control modes."""

from enum import StrEnum

from feasigrasp.plugins import plugins

#: The mode of this package: limits and clearances are enforced.
SAFE = "safe"


class ControlSpace(StrEnum):
    """Space of a controller: hand poses or joint configurations."""

    TASK = "task"
    JOINT = "joint"


def controller_names() -> list[str]:
    """Valid values of ``control.controller``, plugins included."""
    return [*ControlSpace, *plugins("controllers")]


def mode_names() -> list[str]:
    """Valid values of ``control.mode``, plugins included."""
    return [SAFE, *plugins("modes")]
