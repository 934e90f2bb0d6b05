"""The control modes ``paper`` (the method as printed) and ``corrected`` (with corrected laws).

Neither enforces anything. Where neither the paper nor its authors' scripts give a number, it is a
choice:

- The gain of the gradient in task space. The gradient is in 1/rad and 1/m, and the paper has no
  step size. Along the stiffest direction that a fitted mixture can have (standard deviation 5 mm),
  0.005 would bring the hand to the mean in one control period of 5 ms; 0.0005 takes a tenth of the
  way, since the arm follows a tick late.
- The gain of the distance in joint space: 1, as the formula is printed.
- ``n_solutions``: the paper's "typically around 100".
- ``horizon`` of ``reachability.options``: none, since the paper does not look ahead.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp_lab.paper.controllers import (
    PaperJointController,
    PaperTaskController,
    UnenforcedDrive,
)
from feasigrasp_lab.paper.joint_law import PaperJointOptions
from feasigrasp_lab.paper.options import Law, PaperOptions, Source, Targets
from feasigrasp_lab.paper.sources import DRAWS
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
        PaperOptions.of(scenario)

    def make_controller(self, scenario: Scenario, reachability: Reachability) -> GraspController:
        """The paper's controller in task or joint space."""
        space, options = ControlSpace(scenario.control.controller), PaperOptions.of(scenario)
        gain = options.gain or _GAINS[space][options.law == Law.GRADIENT]
        period = scenario.reachability.period
        if space == ControlSpace.TASK:
            of_task = PaperTaskOptions(
                options.law, gain, options.damping, options.feed_forward, options.targets
            )
            seed = scenario.random_seed
            return PaperTaskController(reachability, of_task, period=period, seed=seed)
        of_joint = PaperJointOptions(
            *(options.law, gain, options.feed_forward, options.length_scale, options.n_solutions),
            draw=DRAWS.get(options.source),
            resample=options.resample,
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
        "reachability.symmetric_grasps": False,
        "reachability.options": {"space": "paper", "horizon": 0.0},
        "control.options": {
            "law": Law.GRADIENT.value,
            "feed_forward": False,
            "damping": 0.0,
            "targets": Targets.MEANS.value,
            "length_scale": 0.3,
            "n_solutions": 100,
            "source": Source.FLOW.value,
            "resample": True,
        },
    }
)
