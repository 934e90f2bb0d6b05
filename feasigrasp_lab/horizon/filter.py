"""Reachability filter that keeps the grasps which cost least to intercept and follow."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.predicted_reachability import JudgedGrasps
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.scenario.schema import Scenario
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    optional,
)
from feasigrasp_lab.horizon.interception import find_interceptions
from feasigrasp_lab.horizon.law import HorizonOptions, Situation, total_cost

#: Most grasps that are kept: what a controller ranks anew in 4 ms. Source: guessed.
_MOST = 32
#: A grasp takes the place of one that was kept if it saves this [s]: more than the controller's
#: ``switch``, so that no grasp leaves the set before the controller leaves it. Source: guessed.
_KEPT = 0.5


def make_filter(scenario: Scenario, reachability: Reachability) -> InterceptionFilter:
    """The filter ``interception`` of a scenario."""
    return InterceptionFilter(reachability, scenario.reachability.period)


def intercepted_grasps(
    grasps: GraspSet,
    now: Situation,
    reachability: Reachability,
    options: HorizonOptions,
    kept_before: np.ndarray,
) -> JudgedGrasps:
    """The grasps, flips included, that cost least to intercept and follow.

    One that is never intercepted has the verdict of its present pose, or "out of reach soon" where
    that is in reach; one that costs too much "better grasps in reach".

    Args:
        grasps: Grasps in the object frame.
        now: Arm and object.
        reachability: Hand, limits and clearances.
        options: Instants, limits and weights.
        kept_before: Ids of the grasps that were kept last.
    """
    both, kept = grasps.with_symmetric(), np.zeros(0, dtype=int)
    verdicts = np.full(len(both), Verdict.WRIST, dtype=object)
    if len(both) and np.isfinite(now.X_WO).all() and np.isfinite(now.V_WO).all():
        search = options.interception
        future = now.future(search.times(now.time))
        found = find_interceptions(both.X_OG, future, now.q, now.v, reachability, search, now.time)
        cost = total_cost(found, both.score, options)
        cost -= _KEPT * (np.isin(both.id, kept_before) & (both.id != UNKNOWN))
        order = np.argsort(cost, kind="stable")
        kept = order[np.isfinite(cost[order])][:_MOST]
        never = ~np.isfinite(cost)
        codes = reachability.verdicts(now.X_WO @ both.X_OG)
        reasons = [VERDICTS[code] if code != REACHABLE else Verdict.SOON for code in codes]
        verdicts = np.where(never, np.array(reasons, dtype=object), Verdict.BETTER)
    verdicts[kept] = Verdict.KEPT
    counts = Counter(reason for reason in verdicts if reason != Verdict.KEPT)
    chosen = both.select(kept).counted(counts)
    return JudgedGrasps(replace(chosen, on_object=grasps.id), tuple(verdicts.tolist()))


class InterceptionFilter(LeafSystem):
    """A reachability filter by interceptions, for `HorizonController`.

    .. pydrake_system::

        name: InterceptionFilter
        input_ports:
        - grasps
        - object_pose
        - object_velocity
        - object_motion
        - position
        - desired_velocity
        output_ports:
        - grasps
        - verdicts

    Ports as those of `feasigrasp.systems.reachability_filter.ReachabilityFilter`; beside them the
    joints' V7 ``position`` [rad] and ``desired_velocity`` [rad/s].
    """

    def __init__(
        self, reachability: Reachability, period: float, options: HorizonOptions | None = None
    ) -> None:
        """A filter that remembers every ``period`` seconds [s] which grasps were kept."""
        super().__init__()
        self._reachability, self._options = reachability, options or HorizonOptions()
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        self._twist = declare_input(self, "object_velocity", SpatialVelocity.Zero())
        self._motion = declare_input(self, "object_motion", kind=Motion | None)
        self._position = self.DeclareVectorInputPort("position", IIWA_7.joints)
        self._velocity = self.DeclareVectorInputPort("desired_velocity", IIWA_7.joints)
        self._kept_before = PeriodicState(
            self,
            np.zeros(0, dtype=np.int64),
            period,
            lambda context: judged.Eval(context).grasps.id,
        )
        inputs = (self._grasps, self._pose, self._twist, self._motion, self._kept_before)
        arm = (self._position, self._velocity)
        judged = declare_cache(
            self, "judged", self._calc_judged, {source.ticket() for source in (*inputs, *arm)}
        )
        of_judged = {judged.ticket()}
        declare_output(self, "grasps", lambda context: judged.Eval(context).grasps, of_judged)
        declare_output(self, "verdicts", lambda context: judged.Eval(context).verdicts, of_judged)

    def _calc_judged(self, context: Context) -> JudgedGrasps:
        now = Situation(
            context.get_time(),
            self._position.Eval(context),
            self._velocity.Eval(context),
            self._pose.Eval(context).GetAsMatrix4(),
            self._twist.Eval(context).get_coeffs(),
            optional(self._motion, context),
        )
        grasps, kept = self._grasps.Eval(context), self._kept_before.Eval(context)
        return intercepted_grasps(grasps, now, self._reachability, self._options, kept)
