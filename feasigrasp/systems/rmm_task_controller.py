"""Task-space control over a Riemannian mixture of the reachable grasps."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

from feasigrasp.models.grasp_mixture import GraspMixture, fit_grasp_mixture
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa import NUM_JOINTS
from feasigrasp.models.iiwa_kinematics import forward_kinematics
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.task_space_control import (
    TaskControlOptions,
    paper_task_space_velocity,
    task_space_velocity,
)


class RMMTaskController(LeafSystem):
    """Steers the hand up the log-density of a Riemannian mixture over the grasps.

    .. pydrake_system::

        name: RMMTaskController
        input_ports:
        - position
        - grasps
        - object_pose
        - object_velocity
        output_ports:
        - commanded_velocity

    ``position`` and ``commanded_velocity`` are V7 [rad], [rad/s]; ``grasps`` is a `GraspSet` in the
    object frame, reachable ones. The mixture is a cache entry, fitted once per grasp set.
    Without grasps, or if none can be reached, or while the object's pose or twist is not finite,
    the command is to stop.
    """

    def __init__(
        self,
        reachability: Reachability,
        options: TaskControlOptions | None = None,
        *,
        n_components: int = 6,
        mode: str = "safe",
        seed: int = 0,
    ) -> None:
        """A controller; ``mode`` is ``safe``, or ``paper`` to enforce nothing."""
        super().__init__()
        self._reachability = reachability
        self._options = options or TaskControlOptions()
        self._n_components = n_components
        self._mode = mode
        self._seed = seed
        _compile(reachability, self._options)
        self._position = self.DeclareVectorInputPort("position", NUM_JOINTS)
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self._mixture = self.DeclareCacheEntry(
            "mixture",
            ValueProducer(allocate=lambda: Value[object](None), calc=self._fit),
            prerequisites_of_calc={self._grasps.ticket()},
        )
        self.DeclareVectorOutputPort(
            "commanded_velocity",
            NUM_JOINTS,
            self._calc,
            {
                self._position.ticket(),
                self._mixture.ticket(),
                self._pose.ticket(),
                self._velocity.ticket(),
            },
        )

    def _fit(self, context: Context, value: AbstractValue) -> None:
        grasps: GraspSet = self._grasps.Eval(context)
        value.set_value(None)
        if len(grasps) > 0:
            rng = np.random.default_rng(self._seed)
            value.set_value(fit_grasp_mixture(grasps, self._n_components, rng))

    def mixture(self, context: Context) -> GraspMixture | None:
        """The mixture fitted to the present grasps, in the object frame; None without grasps."""
        mixture: GraspMixture | None = self._mixture.Eval(context)
        return mixture

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        q = self._position.Eval(context)
        mixture = self.mixture(context)
        if mixture is None:
            output.SetFromVector(np.zeros(NUM_JOINTS))
            return
        X_WO = self._pose.Eval(context).GetAsMatrix4()
        V_WO = self._velocity.Eval(context).get_coeffs()
        if self._mode == "paper":
            qd = paper_task_space_velocity(
                q, mixture, X_WO, V_WO, self._reachability.gripper.X_FG, self._options
            )
        else:
            qd = task_space_velocity(q, mixture, X_WO, V_WO, self._reachability, self._options)
        output.SetFromVector(qd)


def _compile(reachability: Reachability, options: TaskControlOptions) -> None:
    """Runs one control step, so that no kernel is compiled inside a control tick."""
    q, X_WO = np.full(NUM_JOINTS, 0.5), np.eye(4)
    X_WG = forward_kinematics(q, reachability.gripper.X_FG)
    mixture = fit_grasp_mixture(
        GraspSet(X_WG[None], np.zeros(1), np.ones(1)), 1, np.random.default_rng(0)
    )
    task_space_velocity(q, mixture, X_WO, np.zeros(6), reachability, options)
