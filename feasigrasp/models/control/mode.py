"""In which space the arm is controlled, by which law, and what is enforced."""

from enum import StrEnum

from feasigrasp.plugins import plugins


class ControlSpace(StrEnum):
    """Where a controller follows grasps: as poses of the hand, or as configurations of the arm."""

    TASK = "task"
    JOINT = "joint"


def controller_names() -> list[str]:
    """What ``control.controller`` may be: our controllers, and those that packages add."""
    return [*ControlSpace, *plugins("controllers")]


class ControlMode(StrEnum):
    """What a controller enforces, and which law it follows unless told otherwise."""

    SAFE = "safe"  # ours; limits and clearances are enforced
    CORRECTED = "corrected"  # the paper's law with our corrections; nothing is enforced
    PAPER = "paper"  # the paper's law as printed; nothing is enforced


class Law(StrEnum):
    """How fast the arm goes up the density of the grasps, or down the distance to them."""

    PRECONDITIONED = "preconditioned"  # at a rate: gain times the way that is left
    GRADIENT = "gradient"  # gain times the gradient, as the paper has it


class Targets(StrEnum):
    """What stands for a component of a mixture of grasps."""

    MEDOIDS = "medoids"  # its most plausible grasp
    MEANS = "means"  # its mean, which need not be one
