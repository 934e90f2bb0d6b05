"""Receding-horizon controller of the arm."""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.clearance_schedule import (
    retreat_velocity,
    scheduled_obstacle,
)
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController
from feasigrasp_lab.horizon.law import (
    HorizonOptions,
    HorizonPlan,
    Situation,
    next_plan,
    plan_velocity,
)
from feasigrasp_lab.horizon.program import ProgramOptions


def make_controller(
    scenario: Scenario, reachability: Reachability, safety: SafetyOptions
) -> HorizonController:
    """The controller ``horizon`` of a scenario; it has no other mode than ``safe``."""
    return HorizonController(reachability, HorizonOptions(program=ProgramOptions(safety=safety)))


class HorizonController(GraspController):
    """Follows the grasp that is soonest intercepted and long enough followed.

    Every update solves a quadratic program over the next second; the memory is a `HorizonPlan`. In
    between the plan is interpolated, and the safety filter keeps limits and clearances.
    """

    def __init__(self, reachability: Reachability, options: HorizonOptions | None = None) -> None:
        """A controller of `next_plan`."""
        self._options = options or HorizonOptions()
        program = self._options.program
        super().__init__(
            reachability, HorizonPlan(), safety=program.safety, period=program.steps[0]
        )
        self.warm_up()

    def update(self, memory: HorizonPlan, inputs: ControllerInputs) -> HorizonPlan:
        """The next plan."""
        qd = inputs.qd_last
        v = np.zeros(IIWA_7.joints) if qd is None else qd
        now = Situation(inputs.time, inputs.q, v, inputs.X_WO, inputs.V_WO, inputs.motion)
        return next_plan(
            *(memory, now, inputs.grasps, self.reachability, self._options),
            committed=inputs.committed,
        )

    def chosen(self, memory: HorizonPlan) -> Array | None:
        """The selected grasp."""
        return memory.X_OG

    def velocity(self, memory: HorizonPlan, inputs: ControllerInputs) -> Array:
        """The velocity of the plan, inside limits and clearances."""
        X_FG, q, last = self.reachability.gripper.X_FG, inputs.q, inputs.qd_last
        grasp = [] if memory.X_OG is None else [memory.X_OG]
        moving = scheduled_obstacle(
            *(inputs.surface, q, inputs.X_WO, inputs.V_WO, X_FG, grasp, self._options.corridor)
        )
        if grasp and moving is not None and moving.misaligned:
            return retreat_velocity(
                self.safety, q, X_FG, moving, qd_last=last, obstacles=inputs.obstacles
            )
        qd = plan_velocity(memory, inputs.time, self._options.program)
        J_WH = pose_and_jacobian(q, X_FG)[1]
        return self.safety.velocity(
            q, qd, J_WH, J_WH @ qd, qd_last=last, obstacles=inputs.obstacles, moving=moving
        )
