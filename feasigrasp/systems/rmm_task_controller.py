"""Task-space controller over a Riemannian mixture of the reachable grasps."""

from __future__ import annotations

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.predicted_poses import predicted_poses
from feasigrasp.models.control.task.memory import TaskMemory
from feasigrasp.models.control.task.safe_law import TaskControlOptions, task_space_velocity
from feasigrasp.models.quantities import Count, Positive, Whole
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.controller_inputs import ControllerInputs
from feasigrasp.systems.grasp_controller import GraspController


class RMMTaskController(GraspController):
    """Steers the hand to a grasp that a Riemannian mixture over the grasps prefers.

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
        seed: Whole = 0,
    ) -> None:
        """A controller of `task_space_velocity`.

        Args:
            reachability: What the arm can reach, and its gripper.
            options: Gains.
            max_components: Most components of the mixture.
            period: Time between updates [s].
            seed: Of the mixture's first fit.
        """
        options = options or TaskControlOptions()
        super().__init__(reachability, TaskMemory(), safety=options.safety, period=period)
        self._options, self._max_components, self._seed = options, max_components, seed
        self.warm_up()

    @checked(ControlError)
    def update(self, memory: TaskMemory, inputs: ControllerInputs) -> TaskMemory:
        """The mixture over the present grasps, in the object frame, and the grasp to follow."""
        memory = memory.with_grasps(inputs.grasps, self._max_components, self._seed)
        choice = self._options.choice
        instants = choice.costs.instants_from(inputs.time, memory.choice.interception_time)
        predicted = predicted_poses(
            choice.prediction, inputs.motion, inputs.X_WO, inputs.V_WO, instants
        )
        return memory.with_choice(
            *(inputs.time, inputs.q, predicted, self.reachability, choice),
            committed=inputs.committed,
        )

    @checked(ControlError)
    def chosen(self, memory: TaskMemory) -> Array | None:
        """The grasp of the choice."""
        return memory.choice.X_OG if memory.choice else None

    @checked(ControlError)
    def velocity(self, memory: TaskMemory, inputs: ControllerInputs) -> Array:
        """Towards the grasp that was chosen."""
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
