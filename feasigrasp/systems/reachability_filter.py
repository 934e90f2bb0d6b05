"""Drops the grasps that the arm cannot reach, now or a moment later."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasp_lookahead import reachable_grasps
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.reachability import Reachability


class ReachabilityFilter(LeafSystem):
    """The reachable grasps of a set, hand poses turned by 180 degrees included.

    .. pydrake_system::

        name: ReachabilityFilter
        input_ports:
        - grasps
        - object_pose
        - object_velocity
        output_ports:
        - grasps

    Grasps are in the object frame, before and after. A grasp and its flip about the approach
    direction are one grasp but two hand poses: both are tried, and both may remain. A pose counts
    as reachable if exact inverse kinematics finds a configuration inside the joint limits, free of
    self-collision and clear of the table, at the object's pose now and, extrapolated with its
    velocity, after ``horizon`` seconds. What is dropped is counted in ``rejected``.
    """

    def __init__(self, reachability: Reachability, *, horizon: float = 1.0) -> None:
        """A filter around an exact inverse kinematics."""
        super().__init__()
        reachability.reachable(np.eye(4))  # compiles its kernels, before the first tick
        self._reachability = reachability
        self._horizon = horizon
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self.DeclareAbstractOutputPort(
            "grasps",
            lambda: AbstractValue.Make(GraspSet.empty()),
            self._calc,
            {self._grasps.ticket(), self._pose.ticket(), self._velocity.ticket()},
        )

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        output.set_value(
            reachable_grasps(
                self._grasps.Eval(context),
                self._pose.Eval(context).GetAsMatrix4(),
                self._velocity.Eval(context).get_coeffs(),
                self._reachability,
                self._horizon,
            )
        )
