"""Settings of the modes ``corrected`` and ``paper``, and of baselines, in ``control.options``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import nearest, parse_choice
from feasigrasp.scenario.schema import Scenario


class Law(StrEnum):
    """How fast the arm goes up the density of the grasps, or down the distance to them."""

    PRECONDITIONED = "preconditioned"  # at a rate: gain times the way that is left
    GRADIENT = "gradient"  # gain times the gradient, as the paper has it


class Targets(StrEnum):
    """What stands for a component of a mixture of grasps."""

    MEDOIDS = "medoids"  # its most plausible grasp
    MEANS = "means"  # its mean, which need not be one


@dataclass(frozen=True)
class PaperOptions:
    """What a scenario says of the laws.

    Attributes:
        law: A `Law`.
        damping: Of the task-space pseudo-inverse, 0 for none.
        targets: What the task-space law goes for, see `Targets`.
        length_scale: Of the joint-space field [rad]; 0 follows the spacing of the solutions.
        resample: Whether solutions are drawn anew at every update, as in the paper; else they keep
            their identity.
    """

    law: str = Law.PRECONDITIONED
    damping: float = 0.02
    targets: str = Targets.MEDOIDS
    length_scale: float = 0.0
    resample: bool = False

    @classmethod
    def of(cls, scenario: Scenario) -> PaperOptions:
        """Those of a scenario.

        Raises:
            ScenarioError: An unknown name, or a value that is out of range.
        """
        given, known = scenario.control.options, {field.name: field.type for field in fields(cls)}
        for name, value in given.items():
            if name not in known:
                raise ScenarioError(
                    f"control.options has no key {name!r}{nearest(name, known) or '.'} It has "
                    f"{', '.join(known)}"
                )
            if type(value).__name__ != known[name] and not (
                known[name] == "float" and isinstance(value, int | float)
            ):
                raise ScenarioError(f"control.options.{name} is {value!r}; give a {known[name]}")
        options = cls(**given)  # type: ignore[arg-type]
        parse_choice(Law, options.law, "control.options.law", ScenarioError)
        parse_choice(Targets, options.targets, "control.options.targets", ScenarioError)
        for name, most, unit in (("damping", 1.0, ""), ("length_scale", 10.0, " rad")):
            value = getattr(options, name)
            if not 0.0 <= value <= most:
                raise ScenarioError(
                    f"control.options.{name} is {value:g}; it must be from 0 to {most:g}{unit}"
                )
        return options
