"""What each control mode means for the keys that a scenario leaves open.

A key of this table that a scenario does not give is None until the scenario is resolved, and then
has the value of its mode; one that is given wins. So ``{mode: paper, feed_forward: true}`` of
``control`` is the paper's law with feed-forward. Reading a scenario resolves it (`load_scenario`,
`parse_scenario`), so that what is written back says what was in force.

``safe`` is ours, ``corrected`` our corrections of the paper's law with nothing enforced, ``paper``
the paper's law as printed, on the paper's field, network and filter. Where neither the paper nor
its authors' scripts give a number, it is a choice:

- ``control.gain`` of the gradient in task space. The gradient is in 1/rad and 1/m, and the paper
  has no step size. Along the stiffest direction that a fitted mixture can have (standard deviation
  5 mm), 0.005 would bring the hand to the mean in one control period of 5 ms; 0.0005 takes a tenth
  of the way, since the arm follows a tick late.
- ``control.gain`` of the distance in joint space: 1, as the formula is printed.
- ``control.gain`` of the energy's gradient (``diffusion``): 0.005 is 5/s times the way that is left
  where the energy is that of noise of its least deviation, 0.03.
- ``control.n_solutions``: the paper's "typically around 100".
- ``reachability.horizon``: none, since the paper does not look ahead.
"""

from __future__ import annotations

import copy
from typing import Any

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import parse_choice, parse_word
from feasigrasp.models.control.mode import (
    ControlMode,
    ControlSpace,
    Law,
    Targets,
    controller_names,
)
from feasigrasp.scenario.schema import Scenario

#: Gains of laws that go at a rate [1/s].
_RATES = {**dict.fromkeys(controller_names(), 5.0), ControlSpace.JOINT: 8.0}
#: By key: the value in ``safe``, in ``corrected``, and in ``paper``. A value that differs between
#: the controllers is a dictionary.
PRESETS: dict[str, tuple[Any, Any, Any]] = {
    "perception.latency": (0.1, 0.1, 0.0),
    "perception.preset": ("default", "default", "paper"),
    "perception.sampler": ("network", "network", "paper"),
    "perception.views": (0, 0, 1),
    "reachability.method": ("ik", "ik", "rmm"),
    "reachability.space": ("default", "default", "paper"),
    "reachability.horizon": (1.0, 1.0, 0.0),
    "reachability.twins": (True, True, False),
    "control.law": (Law.PRECONDITIONED.value, Law.PRECONDITIONED.value, Law.GRADIENT.value),
    "control.gain": (
        _RATES,
        _RATES,
        {
            **_RATES,
            ControlSpace.TASK: 0.0005,
            ControlSpace.JOINT: 1.0,
            "diffusion": 0.005,
        },
    ),
    "control.damping": (0.02, 0.02, 0.0),
    "control.feed_forward": (True, True, False),
    "control.targets": (Targets.MEDOIDS.value, Targets.MEDOIDS.value, Targets.MEANS.value),
    "control.length_scale": (0.0, 0.0, 0.3),
    "control.n_solutions": (64, 64, 100),
    "control.source": ("closed_form", "closed_form", "flow"),
    "control.resample": (False, False, True),
}


def resolve(scenario: Scenario) -> Scenario:
    """The scenario with every key that it leaves open filled in; the one given stays as it is.

    Raises:
        ScenarioError: There is no such mode or controller.
    """
    config = scenario.control
    mode = parse_choice(ControlMode, config.mode, "control.mode", ScenarioError)
    space = parse_word(controller_names(), config.controller, "control.controller", ScenarioError)
    column = (ControlMode.SAFE, ControlMode.CORRECTED, ControlMode.PAPER).index(mode)
    resolved = copy.deepcopy(scenario)
    for key, values in PRESETS.items():
        section, name = key.split(".")
        part, value = getattr(resolved, section), values[column]
        if getattr(part, name) is None:
            setattr(part, name, value[space] if isinstance(value, dict) else value)
    return resolved
