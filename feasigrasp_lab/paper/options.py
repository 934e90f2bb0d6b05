"""Settings of the modes ``corrected`` and ``paper``, and of baselines, in ``control.options``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import Span, nearest, parse_choice
from feasigrasp.scenario.schema import Scenario


class Law(StrEnum):
    """How fast the arm goes up the density of the grasps, or down the distance to them."""

    PRECONDITIONED = "preconditioned"  # at a rate: gain times the way that is left
    GRADIENT = "gradient"  # gain times the gradient, as the paper has it


class Source(StrEnum):
    """Where inverse kinematics solutions come from."""

    CLOSED_FORM = "closed_form"
    FLOW = "flow"  # the IK flow, as in the paper


class Targets(StrEnum):
    """What stands for a component of a mixture of grasps."""

    MEDOIDS = "medoids"  # its most plausible grasp
    MEANS = "means"  # its mean, which need not be one


#: Ranges of the numbers.
_SPANS = {
    "gain": Span(0, 1000, "1/s"),
    "damping": Span(0, 1),
    "length_scale": Span(0, 10, "rad"),
    "n_solutions": Span(1, 10000),
}


@dataclass(frozen=True)
class PaperOptions:
    """Settings of a law.

    Attributes:
        law: A `Law`.
        gain: Rate at which the way that is left decreases, or what the gradient is multiplied with
            [1/s]; 0 for that of the controller, see `gain_or`.
        feed_forward: Whether the object's own motion is added.
        damping: Of the task-space pseudo-inverse, 0 for none.
        targets: What the task-space law goes for, see `Targets`.
        length_scale: Of the joint-space field [rad]; 0 follows the spacing of the solutions.
        n_solutions: How many solutions that field is fitted to, at most.
        source: Where they come from, see `Source`.
        resample: Whether solutions are drawn anew at every update, as in the paper; else they keep
            their identity.
    """

    law: str = Law.PRECONDITIONED
    gain: float = 0.0
    feed_forward: bool = True
    damping: float = 0.02
    targets: str = Targets.MEDOIDS
    length_scale: float = 0.0
    n_solutions: int = 64
    source: str = Source.CLOSED_FORM
    resample: bool = False

    def __post_init__(self) -> None:
        """Checks the values.

        Raises:
            ScenarioError: An unknown word, or a number that is out of range.
        """
        for name, words in (("law", Law), ("targets", Targets), ("source", Source)):
            parse_choice(words, getattr(self, name), f"control.options.{name}", ScenarioError)
        for name, (least, most, unit) in _SPANS.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise ScenarioError(
                    f"control.options.{name} is {value:g}; it must be from {least:g} to {most:g}"
                    f" {unit}".rstrip()
                )
        if self.resample and self.source == Source.CLOSED_FORM:
            raise ScenarioError(
                "control.options.resample is true, but closed_form draws nothing; give "
                f"control.options.source: {Source.FLOW}"
            )

    def gain_or(self, preconditioned: float, gradient: float) -> float:
        """The gain, or if none is given that of the law."""
        return float(self.gain) or (gradient if self.law == Law.GRADIENT else preconditioned)

    @classmethod
    def of(cls, scenario: Scenario) -> PaperOptions:
        """Those of a scenario.

        Raises:
            ScenarioError: An unknown name, or a value of another kind or out of range.
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
        return cls(**given)  # type: ignore[arg-type]
