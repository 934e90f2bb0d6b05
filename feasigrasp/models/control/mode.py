"""In which space the arm is controlled, and what is enforced."""

from enum import StrEnum


class ControlSpace(StrEnum):
    """Where a controller follows grasps: as poses of the hand, or as configurations of the arm."""

    TASK = "task"
    JOINT = "joint"


class ControlMode(StrEnum):
    """What a controller enforces: limits and clearances, or nothing, as in the paper."""

    SAFE = "safe"
    PAPER = "paper"
