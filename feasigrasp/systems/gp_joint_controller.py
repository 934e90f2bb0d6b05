"""Joint-space controller over IK solutions of the reachable grasps."""

from __future__ import annotations

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.joint.law import JointControlOptions, JointSpaceControl
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.quantities import Positive
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController


class GPJointController(GraspController):
    """Descends a Gaussian-process distance field over the grasps' configurations.

    At every evaluation the configurations of all solutions are computed for the present pose of the
    object, the field is fitted to them, and its gradient followed. Every update decides which
    solutions these are, the memory; they keep their identity and count no more and no less at that
    instant, so that the command does not jump. Without solutions, or while the object's pose or
    twist is not finite, the command is to stop.
    """

    @checked(ControlError)
    def __init__(
        self,
        reachability: Reachability,
        options: JointControlOptions | None = None,
        *,
        period: Positive = ReachabilityConfig.period,
    ) -> None:
        """A controller that looks for solutions every ``period`` seconds.

        Args:
            reachability: What the arm can reach, and its gripper.
            options: Gains.
            period: Time between updates [s].
        """
        options = options or JointControlOptions()
        super().__init__(reachability, Solutions.empty(), safety=options.safety, period=period)
        self._control = JointSpaceControl(reachability, options, period)
        self.warm_up()

    @checked(ControlError)
    def update(self, memory: Solutions, inputs: ControllerInputs) -> Solutions:
        """The solutions to follow."""
        return self._control.update(
            memory,
            inputs.time,
            inputs.grasps,
            inputs.X_WO,
            inputs.V_WO,
            inputs.q,
            inputs.motion,
        )

    @checked(ControlError)
    def velocity(self, memory: Solutions, inputs: ControllerInputs) -> Array:
        """Down the field over the solutions."""
        return self._control.velocity(
            inputs.q,
            memory,
            inputs.time,
            inputs.X_WO,
            inputs.V_WO,
            inputs.qd_last,
            inputs.obstacles,
            inputs.surface,
        )
