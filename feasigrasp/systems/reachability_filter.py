"""Drops the grasps that the arm cannot reach, now or a moment later."""

from __future__ import annotations

import numpy as np
from pydrake.common.value import AbstractValue, Value
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.judge import PoseJudge
from feasigrasp.models.reach.lookahead import JudgedGrasps, judge_grasps
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.reach.reachable_space import ReachableSpace
from feasigrasp.scenario.schema import ReachabilityConfig


class ReachabilityFilter(LeafSystem):
    """The reachable grasps of a set, hand poses turned by 180 degrees included.

    .. pydrake_system::

        name: ReachabilityFilter
        input_ports:
        - grasps
        - object_pose
        - object_velocity
        - object_motion
        output_ports:
        - grasps
        - verdicts

    Grasps are in the object frame, before and after. A grasp and its flip about the approach
    direction are one grasp but two hand poses: both are tried, and both may remain. A pose is
    judged by one of three methods:

    - ``ik``: exact inverse kinematics finds a configuration inside the joint limits, free of
      self-collision and clear of the table;
    - ``rmm``: the paper's, the density of the flange pose under a mixture of reachable poses
      exceeds the value that 99 % of reachable poses exceed;
    - ``both``: exact inverse kinematics, of what the mixture lets through.

    A grasp must be in reach at the object's pose now and, as its motion is predicted, all through
    the next ``horizon`` seconds; ``object_motion`` may be left unconnected, then it is extrapolated
    with its velocity. What is dropped is counted by reason in ``rejected``;
    ``verdicts`` is a tuple of strings, see `JudgedGrasps`: what became of every grasp that came in,
    then of every flip.
    """

    def __init__(
        self,
        reachability: Reachability,
        *,
        method: str = ReachabilityConfig.method,
        reachable_space: ReachableSpace | None = None,
        horizon: float = ReachabilityConfig.horizon,
    ) -> None:
        """A filter; ``reachable_space`` is the packaged one of the iiwa unless given.

        Raises:
            ReachabilityError: There is no such method.
        """
        super().__init__()
        self._judge = PoseJudge(reachability, method, reachable_space)
        self._judge.verdicts(np.eye(4))  # compiles its kernels, before the first tick
        self._horizon = horizon
        self._grasps = self.DeclareAbstractInputPort("grasps", AbstractValue.Make(GraspSet.empty()))
        self._pose = self.DeclareAbstractInputPort("object_pose", Value[RigidTransform]())
        self._velocity = self.DeclareAbstractInputPort("object_velocity", Value[SpatialVelocity]())
        self._motion = self.DeclareAbstractInputPort("object_motion", Value[object](None))
        self._judged = self.DeclareCacheEntry(
            "judged",
            ValueProducer(allocate=lambda: Value[object](None), calc=self._calc_judged),
            prerequisites_of_calc={
                self._grasps.ticket(),
                self._pose.ticket(),
                self._velocity.ticket(),
                self._motion.ticket(),
            },
        )
        for name, empty, calc in (
            ("grasps", GraspSet.empty(), self._calc_grasps),
            ("verdicts", (), self._calc_verdicts),
        ):
            self.DeclareAbstractOutputPort(
                name, lambda empty=empty: AbstractValue.Make(empty), calc, {self._judged.ticket()}
            )

    def _calc_judged(self, context: Context, value: AbstractValue) -> None:
        judged = judge_grasps(
            self._grasps.Eval(context),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._judge,
            self._horizon,
            motion=self._motion.Eval(context) if self._motion.HasValue(context) else None,
        )
        value.set_value(judged)

    def _calc_grasps(self, context: Context, output) -> None:
        judged: JudgedGrasps = self._judged.Eval(context)
        output.set_value(judged.grasps)

    def _calc_verdicts(self, context: Context, output) -> None:
        judged: JudgedGrasps = self._judged.Eval(context)
        output.set_value(judged.verdicts)
