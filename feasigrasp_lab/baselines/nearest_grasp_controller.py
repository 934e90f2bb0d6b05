"""Baseline controller: damped tracking of the nearest reachable grasp."""

from __future__ import annotations

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp_lab.baselines.nearest_law import (
    NearestGrasp,
    NearestOptions,
    nearest_grasp,
    nearest_grasp_velocity,
)
from feasigrasp_lab.paper.controllers import Unenforced
from feasigrasp_lab.paper.options import PaperOptions


def make_controller(
    scenario: Scenario, reachability: Reachability, safety: SafetyOptions
) -> NearestGraspController:
    """The controller ``nearest`` of a scenario."""
    given = PaperOptions.of(scenario)
    options = NearestOptions(
        gain=given.gain or NearestOptions.gain,
        damping=given.damping,
        feed_forward=given.feed_forward,
    )
    make = NearestGraspController if scenario.control.safe else _Unenforced
    return make(reachability, options, safety=safety, period=scenario.reachability.period)


class NearestGraspController(GraspController):
    """Follows the grasp that exact inverse kinematics says is nearest, and nothing else.

    At every update the grasp with the least travel time is chosen; the memory is a `NearestGrasp`.
    In between a damped pseudo-inverse leads the hand there, with the object's twist fed forward,
    and in ``safe`` mode the QP keeps limits and clearances.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: NearestOptions | None = None,
        *,
        safety: SafetyOptions | None = None,
        period: float = ReachabilityConfig.period,
    ) -> None:
        """A controller; arguments as of `GraspController`, and the gains of the law."""
        super().__init__(reachability, NearestGrasp(), safety=safety, period=period)
        self._options = options or NearestOptions()
        self.warm_up()

    def update(self, memory: NearestGrasp, inputs: ControllerInputs) -> NearestGrasp:
        """The grasp to follow."""
        X_OG = inputs.grasps.X_OG
        return nearest_grasp(memory, inputs.q, X_OG, inputs.X_WO, self.reachability)

    def chosen(self, memory: NearestGrasp) -> Array | None:
        """The grasp that is followed."""
        return memory.X_OG if memory else None

    def velocity(self, memory: NearestGrasp, inputs: ControllerInputs) -> Array:
        """Towards the grasp."""
        qd = nearest_grasp_velocity(
            inputs.q, memory, inputs.X_WO, inputs.V_WO, self.reachability, self._options
        )
        return self.enforced(qd, inputs)


class _Unenforced(Unenforced, NearestGraspController):
    """The same with nothing enforced."""
