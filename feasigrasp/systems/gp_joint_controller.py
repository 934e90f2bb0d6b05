"""Joint-space control over inverse kinematics solutions of the reachable grasps."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa import NUM_JOINTS
from feasigrasp.models.iiwa_kinematics import forward_kinematics
from feasigrasp.models.joint_space_control import (
    JointControlOptions,
    Solutions,
    find_solutions,
    joint_space_velocity,
)
from feasigrasp.models.reachability import Reachability


class GPJointController(LeafSystem):
    """Descends a Gaussian-process distance field over the grasps' configurations.

    .. pydrake_system::

        name: GPJointController
        input_ports:
        - position
        - grasps
        - object_pose
        - object_velocity
        output_ports:
        - commanded_velocity

    The ports are those of `RMMTaskController`: either controller can replace the other. Every
    ``solution_period`` seconds the configurations that are soonest reached are found anew by exact
    inverse kinematics; in between they follow the object by damped least-squares steps. Without
    solutions, or while the object's pose or twist is not finite, the command is to stop.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: JointControlOptions | None = None,
        *,
        solution_period: float = 0.05,
        mode: str = "safe",
    ) -> None:
        """A controller; ``mode`` is ``safe``, or ``paper`` to enforce nothing."""
        super().__init__()
        self._reachability = reachability
        self._options = options or JointControlOptions()
        self._enforce_limits = mode != "paper"
        _compile(reachability, self._options)
        self._position = self.DeclareVectorInputPort("position", NUM_JOINTS)
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self._solutions = self.DeclareAbstractState(AbstractValue.Make(Solutions.empty()))
        self.DeclarePeriodicUnrestrictedUpdateEvent(solution_period, 0.0, self._find)
        self.DeclareVectorOutputPort(
            "commanded_velocity",
            NUM_JOINTS,
            self._calc,
            {
                self._position.ticket(),
                self._pose.ticket(),
                self._velocity.ticket(),
                self.abstract_state_ticket(self._solutions),
            },
        )

    def _find(self, context: Context, state) -> None:  # type: ignore[no-untyped-def]
        solutions = find_solutions(
            self._grasps.Eval(context),
            self._pose.Eval(context).GetAsMatrix4(),
            self._position.Eval(context),
            self._reachability,
            self._options,
        )
        state.get_mutable_abstract_state(int(self._solutions)).set_value(solutions)

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        qd = joint_space_velocity(
            self._position.Eval(context),
            context.get_abstract_state(int(self._solutions)).get_value(),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._reachability,
            self._options,
            enforce_limits=self._enforce_limits,
        )
        output.SetFromVector(qd)


def _compile(reachability: Reachability, options: JointControlOptions) -> None:
    """Runs one control step, so that no kernel is compiled inside a control tick."""
    q, X_WO = np.full(NUM_JOINTS, 0.5), np.eye(4)
    X_WG = forward_kinematics(q, reachability.gripper.X_FG)
    grasps = GraspSet(X_WG[None], np.zeros(1), np.ones(1))
    solutions = find_solutions(grasps, X_WO, q, reachability, options)
    joint_space_velocity(q, solutions, X_WO, np.zeros(6), reachability, options)
