"""The parts of the dynamic evaluation: what each runs, and what it changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from feasigrasp.scenario.schema import Scenario

#: Object of the size of the paper's, 5.8 x 5.4 x 4.1 cm.
PAPER_OBJECT = "duck"


def _as_it_is(scenario: Scenario) -> None:
    """The conditions of the scenario file."""


def _perfect_sensors(scenario: Scenario) -> None:
    """Depth images without error, and grasps the moment their view is taken."""
    scenario.camera_noise = {}
    scenario.perception.latency = 0.0


def _motion_capture(scenario: Scenario) -> None:
    """A tracker that errs by 2 mm and 1 degree and is 50 ms late."""
    scenario.tracker.position_noise = 0.002
    scenario.tracker.rotation_noise = math.radians(1.0)
    scenario.tracker.latency = 0.05


@dataclass(frozen=True)
class Study:
    """One part of the evaluation, and what its scenarios are run with unless told otherwise.

    Attributes:
        scenarios: Their names.
        objects: What ``--objects`` is by default.
        seeds: Repeats.
        modes: Modes of the controllers.
        suffix: What the names of its runs have behind the scenario's, so that they are not taken
            for those of another study.
        change: Changes a scenario.
        generated: Whether it can run on generated objects, with ``--split test``.
    """

    scenarios: tuple[str, ...]
    objects: str = "builtin"
    seeds: int = 1
    modes: tuple[str, ...] = ("safe",)
    suffix: str = ""
    change: Callable[[Scenario], None] = _as_it_is
    generated: bool = True


_REACH = ("ReachCircular", "ReachLinear", "ReachSinusoidal")
_PAPER = ("PaperCircular", "PaperLinear", "PaperSinusoidal")

#: ``reach`` grasps and lifts moving objects of all kinds, as the scenarios have them; ``ideal`` is
#: the same with perfect sensors, ``tracking`` with the errors of motion capture; ``obstacle``
#: grasps beside a wall; ``paper`` is the paper's dynamic test, slowly and four times as fast.
STUDIES = {
    "reach": Study(_REACH, seeds=3),
    "ideal": Study(_REACH, suffix="-ideal", change=_perfect_sensors),
    "tracking": Study(_REACH, suffix="-tracking", change=_motion_capture),
    "obstacle": Study(("ReachObstacle",), f"{PAPER_OBJECT},soup_can,small_box", 3),
    "paper": Study(
        _PAPER + tuple(f"{name}Fast" for name in _PAPER),
        PAPER_OBJECT,
        5,
        ("paper", "corrected", "safe"),
        generated=False,
    ),
}


def study_of(scenario_name: str) -> Study:
    """The study that a scenario belongs to; of a scenario of one's own, ``reach``."""
    return next(
        (study for study in STUDIES.values() if scenario_name in study.scenarios), STUDIES["reach"]
    )


def suffix_of(run_name: str) -> str:
    """What the study of a run put behind the scenario's name."""
    suffixes = (study.suffix for study in STUDIES.values() if study.suffix)
    return next((suffix for suffix in suffixes if run_name.endswith(suffix)), "")
