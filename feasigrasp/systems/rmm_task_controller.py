"""Task-space control over a Riemannian mixture of the reachable grasps."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ControlError
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.control.safety.obstacle_grid import object_grid, obstacle_grid
from feasigrasp.models.control.safety.safe_velocity import Mode, Safety
from feasigrasp.models.control.task.memory import TaskMemory
from feasigrasp.models.control.task.paper_law import paper_task_space_velocity
from feasigrasp.models.control.task.safe_law import TaskControlOptions, task_space_velocity
from feasigrasp.models.geometry.sphere import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.prediction import future_poses
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import NUM_JOINTS
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.systems.optional_input import declare_derived, eval_optional


class RMMTaskController(LeafSystem):
    """Steers the hand up the log density of a Riemannian mixture over the grasps.

    .. pydrake_system::

        name: RMMTaskController
        input_ports:
        - position
        - grasps
        - object_pose
        - object_velocity
        - desired_velocity
        - scene
        - object_motion
        - gpdf
        output_ports:
        - commanded_velocity

    ``position`` and ``commanded_velocity`` are V7 [rad], [rad/s]; ``grasps`` is a `GraspSet` in the
    object frame, reachable ones. Optional are ``desired_velocity``, the last command as the drive
    carried it out, without which accelerations are not limited; ``scene``, a `SceneField` or None,
    which the arm keeps clear of; ``object_motion``, a `MotionEstimate` that predicts, without which
    the object's twist is taken for constant; and ``gpdf``, the object's `Gpdf` or None, whose
    surface the open hand keeps off.

    Every ``period`` seconds the mixture is fitted anew if the grasps are others, going on from the
    mixture before, and the grasp is chosen that the hand goes for. In between the command is a
    function of the inputs alone. Without grasps, or if none can be reached, or while the object's
    pose or twist is not finite, the command is to stop.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: TaskControlOptions | None = None,
        *,
        max_components: int = 10,
        period: float = 0.05,
        mode: str = Mode.SAFE,
        seed: int = 0,
    ) -> None:
        """A controller; ``mode`` is ``safe``, or ``paper`` to enforce nothing."""
        super().__init__()
        self._reachability = reachability
        self._options = options or TaskControlOptions()
        self._safety = Safety(self._options.safety, reachability.gripper)
        self._max_components = max_components
        self._safe = parse_choice(Mode, mode, "mode", ControlError) is Mode.SAFE
        self._seed = seed
        self._compile()
        self._position = self.DeclareVectorInputPort("position", NUM_JOINTS)
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self._desired_velocity = self.DeclareVectorInputPort("desired_velocity", NUM_JOINTS)
        self._scene = self.DeclareAbstractInputPort("scene", Value[object](None))
        self._motion = self.DeclareAbstractInputPort("object_motion", Value[object](None))
        self._gpdf = self.DeclareAbstractInputPort("gpdf", Value[object](None))
        self._memory = self.DeclareAbstractState(AbstractValue.Make(TaskMemory()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)
        self._obstacles = declare_derived(self, "obstacles", self._scene, obstacle_grid)
        self._surface = declare_derived(self, "surface of the object", self._gpdf, object_grid)
        inputs = {self._position.ticket(), self._pose.ticket(), self._velocity.ticket()}
        inputs.add(self.abstract_state_ticket(self._memory))
        if self._safe:
            inputs |= {self._desired_velocity.ticket(), self.time_ticket()}
            inputs |= {self._obstacles.ticket(), self._surface.ticket()}
        calc = self._calc_safe if self._safe else self._calc_paper
        self.DeclareVectorOutputPort("commanded_velocity", NUM_JOINTS, calc, inputs)

    def memory(self, context: Context) -> TaskMemory:
        """The mixture over the present grasps, in the object frame, and the grasp followed."""
        memory: TaskMemory = context.get_abstract_state(int(self._memory)).get_value()
        return memory

    def _update(self, context: Context, state) -> None:
        memory = self._advanced(
            self.memory(context),
            self._grasps.Eval(context),
            context.get_time(),
            self._position.Eval(context),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            eval_optional(self._motion, context),
        )
        state.get_mutable_abstract_state(int(self._memory)).set_value(memory)

    def _advanced(
        self, memory: TaskMemory, grasps: GraspSet, time, q, X_WO, V_WO, motion
    ) -> TaskMemory:
        memory = memory.with_grasps(grasps, self._max_components, self._seed)
        if not self._safe:
            return memory
        choice = self._options.choice
        ahead = future_poses(motion, X_WO, V_WO, choice.prices.instants)
        return memory.with_choice(time, q, ahead, self._reachability, choice)

    def _calc_safe(self, context: Context, output) -> None:
        qd = task_space_velocity(
            self._position.Eval(context),
            self.memory(context).choice,
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._reachability,
            self._safety,
            self._options,
            time=context.get_time(),
            qd_last=eval_optional(self._desired_velocity, context),
            obstacles=self._obstacles.Eval(context),
            surface=self._surface.Eval(context),
        )
        output.SetFromVector(qd)

    def _calc_paper(self, context: Context, output) -> None:
        mixture = self.memory(context).mixture
        if mixture is None:
            output.SetFromVector(np.zeros(NUM_JOINTS))
            return
        qd = paper_task_space_velocity(
            self._position.Eval(context),
            mixture,
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._reachability.gripper.X_FG,
            self._options,
        )
        output.SetFromVector(qd)

    def _compile(self) -> None:
        """Runs one control step, so that no kernel is compiled inside a control tick."""
        q, X_WO, V_WO = np.full(NUM_JOINTS, 0.5), RigidTransform().GetAsMatrix4(), np.zeros(6)
        X_FG = self._reachability.gripper.X_FG
        X_WG = forward_kinematics(q, X_FG)
        grasps, memory = GraspSet(X_WG[None], np.zeros(1), np.ones(1)), TaskMemory()
        for some in (grasps, grasps.with_twins()):
            memory = self._advanced(memory, some, 0.0, q, X_WO, V_WO, None)
        assert memory.mixture is not None
        if self._safe:
            object_grid(fit_gpdf(sphere_points(64, 0.03)))
            task_space_velocity(
                q, memory.choice, X_WO, V_WO, self._reachability, self._safety, self._options
            )
        else:
            paper_task_space_velocity(q, memory.mixture, X_WO, V_WO, X_FG, self._options)
