"""The control modes ``paper`` (the method as printed) and ``corrected`` (with corrected laws).

Neither enforces anything. Where neither the paper nor its authors' scripts give a number, it is a
choice:

- The gain of the gradient in task space. The gradient is in 1/rad and 1/m, and the paper has no
  step size. Along the stiffest direction that a fitted mixture can have (standard deviation 5 mm),
  0.005 would bring the hand to the mean in one control period of 5 ms; 0.0005 takes a tenth of the
  way, since the arm follows a tick late.
- The gain of the distance in joint space: 1, as the formula is printed.
- ``control.n_solutions``: the paper's "typically around 100".
- ``reachability.horizon``: none, since the paper does not look ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from feasigrasp.errors import ScenarioError
from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.plugins import load_plugin
from feasigrasp.scenario.schema import CLOSED_FORM, Scenario
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp_lab.paper.controllers import (
    PaperJointController,
    PaperTaskController,
    UnenforcedDrive,
)
from feasigrasp_lab.paper.joint_law import PaperJointOptions
from feasigrasp_lab.paper.options import Law, PaperOptions, Targets
from feasigrasp_lab.paper.sources import SOURCES
from feasigrasp_lab.paper.task_law import PaperTaskOptions

#: Gains by controller: of the law ``preconditioned`` [1/s], and of the ``gradient``.
_GAINS = {ControlSpace.TASK: (5.0, 0.0005), ControlSpace.JOINT: (8.0, 1.0)}


@dataclass(frozen=True)
class PaperMode:
    """A mode of the paper.

    Attributes:
        keys: Its defaults by key, ``section.name``.
    """

    keys: Mapping[str, Any] = field(default_factory=dict)

    def fill(self, scenario: Scenario) -> None:
        """Sets its defaults."""
        for key, value in self.keys.items():
            section, name = key.split(".")
            setattr(getattr(scenario, section), name, deepcopy(value))

    def check(self, scenario: Scenario) -> None:
        """Raises ScenarioError where its options are wrong."""
        options = PaperOptions.of(scenario)
        if options.resample and scenario.control.source == CLOSED_FORM:
            raise ScenarioError(
                "control.options.resample is true, but closed_form draws nothing; give "
                f"control.source: {' or '.join(SOURCES)}"
            )

    def make_controller(self, scenario: Scenario, reachability: Reachability) -> GraspController:
        """The paper's controller in task or joint space."""
        config, options = scenario.control, PaperOptions.of(scenario)
        gains = _GAINS[ControlSpace(config.controller)]
        gain = config.gain or gains[options.law == Law.GRADIENT]
        period = scenario.reachability.period
        if config.controller == ControlSpace.TASK:
            of_task = PaperTaskOptions(
                options.law, gain, options.damping, config.feed_forward, options.targets
            )
            seed = scenario.random_seed
            return PaperTaskController(reachability, of_task, period=period, seed=seed)
        solutions = SolutionOptions(n_solutions=config.n_solutions, glide=0.0)
        if config.source != CLOSED_FORM:
            find = load_plugin("ik_sources", config.source)
            solutions = SolutionOptions(find, config.n_solutions, glide=0.0)
        of_joint = PaperJointOptions(
            *(options.law, gain, config.feed_forward, options.length_scale, solutions),
            draw=SOURCES[config.source] if options.resample else None,
        )
        return PaperJointController(reachability, of_joint, period=period)

    def make_drive(self, scenario: Scenario) -> UnenforcedDrive:
        """A drive that bounds nothing."""
        return UnenforcedDrive(scenario.control.period)


CORRECTED = PaperMode()
PAPER = PaperMode(
    {
        "perception.latency": 0.0,
        "perception.preset": "paper",
        "perception.sampler": "paper",
        "perception.views": 1,
        "reachability.method": "rmm",
        "reachability.horizon": 0.0,
        "reachability.symmetric_grasps": False,
        "reachability.options": {"space": "paper"},
        "control.feed_forward": False,
        "control.n_solutions": 100,
        "control.source": "flow",
        "control.options": {
            "law": Law.GRADIENT.value,
            "damping": 0.0,
            "targets": Targets.MEANS.value,
            "length_scale": 0.3,
            "resample": True,
        },
    }
)
