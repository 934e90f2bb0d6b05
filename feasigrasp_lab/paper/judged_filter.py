"""Reachability filter by a judge of hand poses, such as the paper's density of reachable poses."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ReachabilityError, ScenarioError
from feasigrasp.models.arguments import checked
from feasigrasp.models.choices import parse_word
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.reach.feasible_grasps import JudgedGrasps
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    optional,
)
from feasigrasp_lab.paper.predicted_reachability import (
    WAY_IN,
    Judge,
    KeepingRule,
    judge_grasps,
)


def make_judged_filter(scenario: Scenario, judge: Judge) -> JudgedFilter:
    """The filter of a scenario by a judge; modes that enforce nothing skip the way in."""
    config = scenario.reachability
    for name in config.options:
        parse_word(("space", "horizon"), name, "a key of reachability.options", ScenarioError)
    horizon: Any = config.options.get("horizon", 1.0)
    return JudgedFilter(
        judge,
        horizon=horizon,
        symmetric_grasps=config.symmetric_grasps,
        way_in=WAY_IN if scenario.control.safe else 0.0,
        period=config.period,
    )


class JudgedFilter(LeafSystem):
    """The reachable grasps of a set, hand poses turned by 180 degrees included.

    .. pydrake_system::

        name: JudgedFilter
        input_ports:
        - grasps
        - object_pose
        - object_velocity
        - object_motion
        output_ports:
        - grasps
        - verdicts

    Grasps are in the object frame, before and after. A grasp and its flip about the approach
    direction are one grasp but two hand poses: both are tried by default, and both may
    remain. A pose is in reach if exact inverse kinematics finds a configuration inside the joint
    limits, free of self-collision and clear of the table, or whatever else the judge asks for.

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
        judge: Judge,
        *,
        horizon: NotNegative = 1.0,
        symmetric_grasps: bool = True,
        way_in: NotNegative = WAY_IN,
        period: Positive = ReachabilityConfig.period,
    ) -> None:
        """A filter by a judge, such as `Reachability`.

        Without ``symmetric_grasps`` grasps are judged as they are, not their flips. Which grasps
        were kept is remembered every ``period`` seconds.
        """
        super().__init__()
        self._judge = judge
        self._judge.verdicts(np.eye(4))  # compiles its kernels, before the first tick
        self._horizon, self._symmetric_grasps, self._way_in = horizon, symmetric_grasps, way_in
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
            motion=optional(self._motion, context),
            kept_before=self._kept_before.Eval(context),
            rule=KeepingRule(symmetric_grasps=self._symmetric_grasps, way_in=self._way_in),
        )
