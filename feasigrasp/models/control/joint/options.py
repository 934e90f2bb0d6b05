"""Options for the set of IK solutions of the joint-space controller."""

from __future__ import annotations

from dataclasses import dataclass

from feasigrasp.errors import ControlError
from feasigrasp.models.control.joint.sources import FindConfigurations, closed_form_configurations


@dataclass(frozen=True)
class SolutionOptions:
    """Options for the selection of IK solutions.

    Attributes:
        find: Finds new ones, by default by the closed form.
        n_solutions: How many are kept. The best one of every grasp comes first.
        per_grasp: How many of one grasp, at most.
        cost_rate: How fast a cost changes at most [rad/s].
        glide: Largest rate of an arm angle [rad/s].
        glide_acceleration: Its largest change [rad/s^2].
        glide_gain: Rate per distance to the arm angle of least cost [1/s].
        radians_per_second: How far it is worth going for a solution that costs a second less.
    """

    find: FindConfigurations = closed_form_configurations
    n_solutions: int = 64
    per_grasp: int = 4
    cost_rate: float = 4.0
    glide: float = 0.6
    glide_acceleration: float = 3.0
    glide_gain: float = 2.0
    radians_per_second: float = 1.0

    def __post_init__(self) -> None:
        """Checks the numbers."""
        if self.n_solutions < 1 or self.per_grasp < 1:
            raise ControlError(
                f"n_solutions is {self.n_solutions} and per_grasp {self.per_grasp}; "
                "give at least 1 of each"
            )
