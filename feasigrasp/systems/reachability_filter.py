"""Drops the grasps that the arm cannot reach, now or a moment later."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import checked
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.reach.judge import JudgeMethod, PoseJudge
from feasigrasp.models.reach.lookahead import WAY_IN, JudgedGrasps, judge_grasps
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.reach.reachable_space import ReachableSpace
from feasigrasp.scenario.schema import ReachabilityConfig
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    optional,
)


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
    direction are one grasp but two hand poses: both are tried, unless told otherwise, and both may
    remain. A pose is judged by one of these methods:

    - ``ik``: exact inverse kinematics finds a configuration inside the joint limits, free of
      self-collision and clear of the table;
    - ``rmm``: the paper's, the density of the flange pose under a mixture of reachable poses
      exceeds the value that 99 % of reachable poses exceed;
    - ``both``: exact inverse kinematics, of what the mixture lets through;
    - ``none``: nothing is judged, only counted.

    A grasp must be in reach at the object's pose now and, as its motion is predicted, all through
    the next ``horizon`` seconds; ``object_motion`` may be left unconnected, then it is extrapolated
    with its velocity. Of these the hand must be able to stand back by ``way_in``, along the
    approach direction, unless that leaves none. Of more than can be planned for, those are kept
    that score best; which they are changes only for clearly better ones, since whoever follows a
    grasp has to find it again. What is dropped is counted by reason in ``rejected``; ``verdicts``
    is a tuple of strings, see `JudgedGrasps`: what became of every grasp that came in, then of
    every flip.
    """

    @checked(ReachabilityError)
    def __init__(
        self,
        reachability: Reachability,
        *,
        method: str = JudgeMethod.IK,
        reachable_space: ReachableSpace | None = None,
        horizon: NotNegative = 1.0,
        twins: bool = True,
        way_in: NotNegative = WAY_IN,
        period: Positive = ReachabilityConfig.period,
    ) -> None:
        """A filter; ``reachable_space`` is the packaged one of the iiwa unless given.

        Without ``twins`` grasps are judged as they are, not their flips. Which grasps were kept is
        remembered every ``period`` seconds.

        Raises:
            ReachabilityError: There is no such method.
        """
        super().__init__()
        self._judge = PoseJudge(reachability, method, reachable_space)
        self._judge.verdicts(np.eye(4))  # compiles its kernels, before the first tick
        self._horizon, self._twins, self._way_in = horizon, twins, way_in
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._velocity = declare_input(self, "object_velocity", SpatialVelocity.Zero())
        self._motion = declare_input(self, "object_motion", kind=Motion | None)
        self._kept_before = PeriodicState(
            self,
            np.zeros(0, dtype=np.int64),
            period,
            lambda context: judged.Eval(context).grasps.id,
        )
        inputs = (self._grasps, self._pose, self._velocity, self._motion, self._kept_before)
        judged = declare_cache(
            self, "judged", self._calc_judged, {source.ticket() for source in inputs}
        )
        of_judged = {judged.ticket()}
        declare_output(self, "grasps", lambda context: judged.Eval(context).grasps, of_judged)
        declare_output(self, "verdicts", lambda context: judged.Eval(context).verdicts, of_judged)

    def _calc_judged(self, context: Context) -> JudgedGrasps:
        return judge_grasps(
            self._grasps.Eval(context),
            self._pose.Eval(context).GetAsMatrix4(),
            self._velocity.Eval(context).get_coeffs(),
            self._judge,
            self._horizon,
            twins=self._twins,
            way_in=self._way_in,
            motion=optional(self._motion, context),
            kept_before=self._kept_before.Eval(context),
        )
