"""Settings of the modes ``corrected`` and ``paper``, and of baselines, in ``control.options``."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import key, metadata_of, nearest, parse_word, word
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

    law: str = word(Law.PRECONDITIONED, Law)
    gain: float = key(0.0, 0, 1000, "1/s")
    feed_forward: bool = True
    damping: float = key(0.02, 0, 1)
    targets: str = word(Targets.MEDOIDS, Targets)
    length_scale: float = key(0.0, 0, 10, "rad")
    n_solutions: int = key(64, 1, 10000)
    source: str = word(Source.CLOSED_FORM, Source)
    resample: bool = False

    def __post_init__(self) -> None:
        """Checks the values.

        Raises:
            ScenarioError: An unknown word, or a number that is out of range.
        """
        for name, stated in metadata_of(type(self)).items():
            value, what = getattr(self, name), f"control.options.{name}"
            if "words" in stated:
                parse_word(stated["words"], value, what, ScenarioError)
            elif span := stated.get("span"):
                least, most, unit = span
                if not least <= value <= most:
                    text = f"{what} is {value:g}; it must be from {least:g} to {most:g} {unit}"
                    raise ScenarioError(text.rstrip())
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
