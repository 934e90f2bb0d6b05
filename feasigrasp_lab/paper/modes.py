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

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.systems.framework import Context

from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.safety.velocity_limits import is_fault_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.grasp_controller import ControllerInputs, GraspController
from feasigrasp.systems.velocity_drive import VelocityDrive
from feasigrasp_lab.paper.grasp_mixture import MixtureMemory
from feasigrasp_lab.paper.joint_law import PaperJointControl
from feasigrasp_lab.paper.options import Law, PaperOptions, Source, Targets
from feasigrasp_lab.paper.solutions import Solutions
from feasigrasp_lab.paper.task_law import paper_task_space_velocity

_CHAIN = IIWA_7.chain


class Unenforced:
    """A controller whose law is its command: no limits, clearances, view, or reaction to contact.

    The first base of a class, before a `GraspController`. It is no system itself: Drake refuses
    classes with two bases of its own.
    """

    def enforced(
        self, qd: Array, inputs: ControllerInputs, J: Array | None = None, V: Array | None = None
    ) -> Array:
        """The velocity itself."""
        return qd

    def in_view(self, qd: Array, inputs: ControllerInputs) -> Array:
        """The velocity itself."""
        return qd

    def _search(self, context: Context) -> None:
        """The arm looks for nothing."""

    def _calc(self: Any, context: Context, output) -> None:
        output.SetFromVector(self.velocity(self.memory(context), ControllerInputs(self, context)))


@compiled
def _free_step_kernel(q, command, period, q_next, v_next):
    """As `drive_step_kernel`, with nothing bounded; a command that is not finite counts as zero."""
    finite = np.isfinite(command.sum())
    for i in range(len(q)):
        v_next[i] = command[i] if finite else 0.0
        q_next[i] = q[i] + period * v_next[i]
    return is_fault_kernel(_CHAIN, command)


class UnenforcedDrive(VelocityDrive):
    """A `VelocityDrive` that integrates commands as they come; a non-finite one counts as zero."""

    def _step(self, q: Array, v: Array, command: Array, measured: Array) -> tuple[Array, bool]:
        desired = np.empty(2 * IIWA_7.joints)
        q_next, v_next = desired[: IIWA_7.joints], desired[IIWA_7.joints :]
        fault = _free_step_kernel(q, command, self._period, q_next, v_next)
        return desired, fault


class PaperTaskController(Unenforced, GraspController):
    """Steers the hand up the log density of a Riemannian mixture over the grasps.

    At every update the mixture is fitted anew if the grasps are others. Without grasps, or while
    the object's pose or twist is not finite, the command is to stop.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: PaperOptions | None = None,
        *,
        max_components: int = 10,
        period: float = ReachabilityConfig.period,
        seed: int = 0,
    ) -> None:
        """A controller of `paper_task_space_velocity`; arguments as of `RMMTaskController`."""
        super().__init__(reachability, MixtureMemory(), period=period)
        self._options, self._max_components = options or PaperOptions(), max_components
        self._seed = seed
        self.warm_up()

    def update(self, memory: MixtureMemory, inputs: ControllerInputs) -> MixtureMemory:
        """The mixture over the present grasps, in the object frame."""
        return memory.with_grasps(inputs.grasps, self._max_components, self._seed)

    def velocity(self, memory: MixtureMemory, inputs: ControllerInputs) -> Array:
        """Up the density of all grasps."""
        if memory.mixture is None:
            return np.zeros(IIWA_7.joints)
        X_FG = self.reachability.gripper.X_FG
        return paper_task_space_velocity(
            inputs.q, memory.mixture, inputs.X_WO, inputs.V_WO, X_FG, self._options
        )


class PaperJointController(Unenforced, GraspController):
    """Descends a Gaussian-process distance field over the grasps' configurations.

    Without solutions, or while the object's pose or twist is not finite, the command is to stop.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: PaperOptions | None = None,
        *,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A controller of `PaperJointControl`; arguments as of `GPJointController`."""
        super().__init__(reachability, Solutions.empty(), period=period)
        self._control = PaperJointControl(reachability, options or PaperOptions(), period)
        self.warm_up()

    def update(self, memory: Solutions, inputs: ControllerInputs) -> Solutions:
        """The solutions to follow."""
        return self._control.update(
            *(memory, inputs.time, inputs.grasps, inputs.X_WO, inputs.V_WO, inputs.q), inputs.motion
        )

    def velocity(self, memory: Solutions, inputs: ControllerInputs) -> Array:
        """Down the field over the solutions."""
        return self._control.velocity(inputs.q, memory, inputs.time, inputs.X_WO, inputs.V_WO)


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
        options, period = PaperOptions.of(scenario), scenario.reachability.period
        if scenario.control.controller == ControlSpace.TASK:
            seed = scenario.random_seed
            return PaperTaskController(reachability, options, period=period, seed=seed)
        return PaperJointController(reachability, options, period=period)

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
