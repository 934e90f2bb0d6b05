"""Which inverse-kinematics solutions the joint-space controller keeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.control.joint.sources import Source


@dataclass(frozen=True)
class SolutionOptions:
    """Which solutions are kept.

    Attributes:
        source: Where they come from: ``closed_form``, ``flow`` (drawn from the IK flow, refined) or
            ``dls`` (damped least squares from random configurations).
        n_solutions: How many are kept. The best one of every grasp comes first.
        resample: Whether they are drawn anew at every update, with the same random numbers, as in
            the paper, and cost nothing; from ``flow`` or ``dls``.
        length_scale: Of the field [rad]; 0 follows the spacing of the solutions.
        per_grasp: How many of one grasp, at most; not if they are drawn anew.
        cost_rate: How fast a cost changes at most [rad/s].
        glide: Largest rate of an arm angle [rad/s].
        glide_acceleration: Its largest change [rad/s^2].
        glide_gain: Rate per distance to the arm angle of least cost [1/s].
        radians_per_second: How far it is worth going for a solution that costs a second less.
    """

    source: str = Source.CLOSED_FORM
    n_solutions: int = 64
    resample: bool = False
    length_scale: float = 0.0
    per_grasp: int = 4
    cost_rate: float = 4.0
    glide: float = 0.6
    glide_acceleration: float = 3.0
    glide_gain: float = 2.0
    radians_per_second: float = 1.0

    def __post_init__(self) -> None:
        """Checks the choice."""
        source = parse_choice(Source, self.source, "source", ControlError)
        object.__setattr__(self, "source", source)
        if self.n_solutions < 1 or self.per_grasp < 1:
            raise ControlError(
                f"n_solutions is {self.n_solutions} and per_grasp {self.per_grasp}; "
                "give at least 1 of each"
            )
        if not 0.0 <= self.length_scale < np.inf:
            raise ControlError(
                f"length_scale is {self.length_scale}; give a positive one [rad], or 0 for that of "
                "the solutions' spacing"
            )
        if self.resample and source is Source.CLOSED_FORM:
            raise ControlError(
                "resample needs something to draw from: give the source flow or dls, or "
                "resample: false"
            )
