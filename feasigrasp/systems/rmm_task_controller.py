"""Task-space control over a Riemannian mixture of the reachable grasps."""

from __future__ import annotations

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.mode import ControlMode
from feasigrasp.models.control.planning.outlook import poses_ahead
from feasigrasp.models.control.task.memory import TaskMemory
from feasigrasp.models.control.task.paper_law import paper_task_space_velocity
from feasigrasp.models.control.task.safe_law import TaskControlOptions, task_space_velocity
from feasigrasp.models.quantities import Count, Positive, Whole
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController


class RMMTaskController(GraspController):
    """Steers the hand up the log density of a Riemannian mixture over the grasps.

    At every update the mixture is fitted anew if the grasps are others, going on from the mixture
    before, and the grasp is chosen that the hand goes for; the memory is a `TaskMemory`. In between
    the command is a function of the inputs alone. Without grasps, or if none can be reached, or
    while the object's pose or twist is not finite, the command is to stop.
    """

    @checked(ControlError)
    def __init__(
        self,
        reachability: Reachability,
        options: TaskControlOptions | None = None,
        *,
        max_components: Count = 10,
        period: Positive = ReachabilityConfig.period,
        mode: str = ControlMode.SAFE,
        seed: Whole = 0,
    ) -> None:
        """A controller; ``mode`` is ``safe``, or one that enforces nothing.

        The law of such a mode is what ``options`` say, whichever it is.

        Raises:
            ControlError: There is no such mode.
        """
        options = options or TaskControlOptions()
        super().__init__(
            reachability, TaskMemory(), safety=options.safety, period=period, mode=mode
        )
        self._options, self._max_components, self._seed = options, max_components, seed
        self.rehearse()

    @checked(ControlError)
    def update(self, memory: TaskMemory, inputs: ControllerInputs) -> TaskMemory:
        """The mixture over the present grasps, in the object frame, and the grasp to follow."""
        memory = memory.with_grasps(inputs.grasps, self._max_components, self._seed)
        if self.safety is None:
            return memory
        choice = self._options.choice
        instants = choice.prices.instants_from(inputs.time, memory.choice.due)
        ahead = poses_ahead(choice.look_ahead, inputs.motion, inputs.X_WO, inputs.V_WO, instants)
        return memory.with_choice(
            *(inputs.time, inputs.q, ahead, self.reachability, choice), committed=inputs.committed
        )

    @checked(ControlError)
    def chosen(self, memory: TaskMemory) -> Array | None:
        """The grasp of the choice; None in a mode that enforces nothing, which follows them all."""
        return memory.choice.X_OG if memory.choice else None

    @checked(ControlError)
    def velocity(self, memory: TaskMemory, inputs: ControllerInputs) -> Array:
        """Towards the grasp that was chosen; if nothing is enforced, up the density of all."""
        if self.safety is not None:
            return task_space_velocity(
                inputs.q,
                memory.choice,
                inputs.X_WO,
                inputs.V_WO,
                self.reachability,
                self.safety,
                self._options,
                time=inputs.time,
                motion=inputs.motion,
                qd_last=inputs.qd_last,
                obstacles=inputs.obstacles,
                surface=inputs.surface,
            )
        if memory.mixture is None:
            return np.zeros(IIWA_7.joints)
        return paper_task_space_velocity(
            inputs.q,
            memory.mixture,
            inputs.X_WO,
            inputs.V_WO,
            self.reachability.gripper.X_FG,
            self._options,
        )
