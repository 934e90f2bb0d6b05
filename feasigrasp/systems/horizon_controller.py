"""Receding-horizon controllers of the arm, in task space and in joint space."""

from typing import ClassVar

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.control.horizon.law import (
    HorizonOptions,
    HorizonPlan,
    next_plan,
    plan_velocity,
)
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.planning.clearance_schedule import scheduled_obstacle, step_back
from feasigrasp.models.control.safety.safe_velocity import SafetyOptions
from feasigrasp.models.reach.interception import Situation
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.kinematics import pose_and_jacobian
from feasigrasp.systems.grasp_controller import ControllerInputs, GraspController


class HorizonController(GraspController):
    """Follows the grasp that is soonest intercepted and long enough followed, and those near it.

    Every update solves a quadratic program over the next second; the memory is a `HorizonPlan`. In
    between the plan is interpolated, and the safety filter keeps limits and clearances. Without
    grasps, or while the object's pose or twist is not finite, the command is to stop.

    Attributes:
        space: Space of the term over the grasps.
    """

    space: ClassVar[ControlSpace]

    @checked(ControlError)
    def __init__(self, reachability: Reachability, options: HorizonOptions | None = None) -> None:
        """A controller of `next_plan`, with weights and limits as ``options``."""
        self._options = options or HorizonOptions(
            program=ProgramOptions(safety=SafetyOptions.of(reachability.arm))
        )
        program = self._options.program
        if not np.array_equal(program.safety.arm.chain, reachability.arm.chain):
            raise ControlError(
                f"options.program.safety.arm is {program.safety.arm.name}, that of reachability "
                f"{reachability.arm.name}; give SafetyOptions.of(reachability.arm)"
            )
        super().__init__(
            reachability, HorizonPlan(), safety=program.safety, period=program.steps[0]
        )
        self.warm_up()

    @checked(ControlError)
    def update(self, memory: HorizonPlan, inputs: ControllerInputs) -> HorizonPlan:
        """The next plan."""
        qd, program = inputs.qd_last, self._options.program
        if qd is None:  # taken to do as planned
            qd = plan_velocity(memory, inputs.time - program.safety.period, program)
        state = inputs.q, qd, inputs.X_WO, inputs.V_WO
        now = Situation(inputs.time, *state, inputs.motion, self._options.prediction)
        return next_plan(
            *(memory, now, inputs.grasps, self.reachability, self._options, self.space),
            committed=inputs.committed,
            surface=inputs.surface,
        )

    @checked(ControlError)
    def chosen(self, memory: HorizonPlan) -> Array | None:
        """The selected grasp."""
        return memory.X_OG

    @checked(ControlError)
    def velocity(self, memory: HorizonPlan, inputs: ControllerInputs) -> Array:
        """The velocity of the plan, inside limits and clearances."""
        if not np.isfinite(inputs.X_WO.sum() + inputs.V_WO.sum()):  # lost since the last update
            memory = memory.without_grasp(inputs.time)
        arm, X_FG, q = self.reachability.arm, self.reachability.gripper.X_FG, inputs.q
        grasp, qd = memory.near.X_OG[:1], np.zeros(len(q))
        J_WH: Array | None = None
        V_WH: Array | None = None
        moving = scheduled_obstacle(
            *(inputs.surface, q, inputs.X_WO, inputs.V_WO, X_FG, grasp, self._options.corridor),
            arm=arm,
        )
        if len(grasp):
            X_WH, J_WH = pose_and_jacobian(q, X_FG, arm)
            if moving is not None and moving.misaligned:
                V_WH = step_back(X_WH, moving.X_WO, moving.V_WO)
            else:
                qd = plan_velocity(memory, inputs.time, self._options.program)
                V_WH = J_WH @ qd
        return self.safety.velocity(
            *(q, qd, J_WH, V_WH),
            qd_last=inputs.qd_last,
            obstacles=inputs.obstacles,
            moving=moving,
        )


class RMMTaskController(HorizonController):
    """Plans down the negative log density of a Riemannian mixture over the grasps.

    See `feasigrasp.models.control.horizon.density`.
    """

    space = ControlSpace.TASK


class GPJointController(HorizonController):
    """Plans down a Gaussian-process distance field over the grasps' configurations.

    See `feasigrasp.models.control.horizon.distance`.
    """

    space = ControlSpace.JOINT
