"""Joint-space control over inverse kinematics solutions of the reachable grasps."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.control.joint.law import JointControlOptions, JointSpaceControl
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.control.safety.obstacle_grid import object_grid, obstacle_grid
from feasigrasp.models.control.safety.safe_velocity import Mode
from feasigrasp.models.geometry.sphere import sphere_points
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import NUM_JOINTS
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.models.shape.gpdf_fit import fit_gpdf
from feasigrasp.systems.optional_input import declare_derived, eval_optional


class GPJointController(LeafSystem):
    """Descends a Gaussian-process distance field over the grasps' configurations.

    .. pydrake_system::

        name: GPJointController
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

    The ports are those of `RMMTaskController`: either controller can replace the other. At every
    evaluation the configurations of all solutions are computed for the present pose of the object,
    the field is fitted to them, and its gradient followed. Every ``solution_period`` seconds it is
    decided which solutions these are; they keep their identity and count no more and no less at
    that instant, so that the command does not jump. Without solutions, or while the object's pose
    or twist is not finite, the command is to stop.

    ``desired_velocity`` V7 [rad/s], the drive's last command, lets ``safe`` mode keep to the
    acceleration limits; ``scene``, a `SceneField` or None, is kept clear of; ``object_motion``, a
    `MotionEstimate`, predicts the object's poses; off the surface of ``gpdf``, the object's `Gpdf`
    or None, the open hand keeps. These four are optional.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: JointControlOptions | None = None,
        *,
        solution_period: float = 0.05,
        mode: str = Mode.SAFE,
    ) -> None:
        """A controller; ``mode`` is ``safe``, or ``paper`` to enforce nothing."""
        super().__init__()
        self._control = JointSpaceControl(
            reachability, options or JointControlOptions(), solution_period, mode
        )
        _compile(self._control)
        self._position = self.DeclareVectorInputPort("position", NUM_JOINTS)
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self._desired_velocity = self.DeclareVectorInputPort("desired_velocity", NUM_JOINTS)
        self._scene = self.DeclareAbstractInputPort("scene", Value[object](None))
        self._motion = self.DeclareAbstractInputPort("object_motion", Value[object](None))
        self._gpdf = self.DeclareAbstractInputPort("gpdf", Value[object](None))
        self._obstacles = declare_derived(self, "obstacles", self._scene, obstacle_grid)
        self._surface = declare_derived(self, "surface of the object", self._gpdf, object_grid)
        self._solutions = self.DeclareAbstractState(AbstractValue.Make(Solutions.empty()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(solution_period, 0.0, self._find)
        self.DeclareVectorOutputPort(
            "commanded_velocity",
            NUM_JOINTS,
            self._calc,
            {
                self.time_ticket(),
                self._position.ticket(),
                self._pose.ticket(),
                self._velocity.ticket(),
                self._desired_velocity.ticket(),
                self._obstacles.ticket(),
                self._surface.ticket(),
                self.abstract_state_ticket(self._solutions),
            },
        )

    def solutions(self, context: Context) -> Solutions:
        """The solutions that are followed now."""
        found: Solutions = context.get_abstract_state(int(self._solutions)).get_value()
        return found

    def _find(self, context: Context, state) -> None:
        solutions = self._control.update(
            self.solutions(context),
            context.get_time(),
            self._grasps.Eval(context).X_OG,
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._position.Eval(context),
            eval_optional(self._motion, context),
        )
        state.get_mutable_abstract_state(int(self._solutions)).set_value(solutions)

    def _calc(self, context: Context, output) -> None:
        qd = self._control.velocity(
            self._position.Eval(context),
            self.solutions(context),
            context.get_time(),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            eval_optional(self._desired_velocity, context),
            self._obstacles.Eval(context),
            self._surface.Eval(context),
        )
        output.SetFromVector(qd)


def _compile(control: JointSpaceControl) -> None:
    """Runs two updates and a step, so that no kernel is compiled inside a control tick."""
    q, X_WO, V_WO = np.full(NUM_JOINTS, 0.5), np.eye(4), np.zeros(6)
    X_OG = forward_kinematics(q, control.reachability.gripper.X_FG)[None]
    solutions = Solutions.empty()
    for time in (0.0, control.period):
        solutions = control.update(solutions, time, X_OG, X_WO, V_WO, q)
    control.velocity(q, solutions, control.period, X_WO, V_WO, np.zeros(NUM_JOINTS))
    if control.safety is not None:
        object_grid(fit_gpdf(sphere_points(64, 0.03)))
