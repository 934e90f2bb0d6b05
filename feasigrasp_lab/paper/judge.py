"""Reachability tests by name, density of reachable poses or density and exact IK, and their filter.

The paper calls a pose reachable if its density under a mixture of reachable poses exceeds a
threshold (section IV-B). That is quick and soft: it lets poses through that no configuration
reaches. Exact inverse kinematics decides, with a reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import ReachabilityError, ScenarioError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Frozen
from feasigrasp.models.choices import parse_word
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import ANY_POSES, NotNegative, Positive
from feasigrasp.models.reach.feasible_grasps import JudgedGrasps
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.scenario.schema import ReachabilityConfig, Scenario
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    optional,
)
from feasigrasp_lab.paper.predicted_reachability import WAY_IN, Judge, judge_grasps
from feasigrasp_lab.paper.reachable_space import ReachableSpace, SpaceName


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

    `judge_grasps` says which grasps are kept, with the motion predicted by ``object_motion``; that
    may be left unconnected, then it is extrapolated with its velocity. What is dropped is
    counted by reason in ``rejected``; ``verdicts`` is a tuple of strings, see `JudgedGrasps`: what
    became of every grasp that came in, then of every flip.
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
            symmetric_grasps=self._symmetric_grasps,
            way_in=self._way_in,
        )


_UNLIKELY = VERDICTS.index(Verdict.UNLIKELY)


class JudgeMethod(StrEnum):
    """How hand poses are judged."""

    IK = "ik"  # exact
    RMM = "rmm"  # the paper's density
    BOTH = "both"  # the paper's, and exact on what passes
    NONE = "none"  # whatever pose is known counts as reachable


@dataclass(frozen=True, eq=False)
class PoseJudge(Frozen):
    """Says which hand poses can be reached, and why the others cannot.

    Attributes:
        reachability: Exact inverse kinematics; its gripper gives the pose of the flange.
        method: Exact, the paper's, both, or none at all; a `JudgeMethod` or its word.
        space: Density of reachable flange poses, for ``rmm`` and ``both``; the packaged one of the
            iiwa if not given.

    Raises:
        ReachabilityError: There is no such method.
    """

    reachability: Reachability
    method: JudgeMethod | str = JudgeMethod.IK
    space: ReachableSpace | None = None

    def __post_init__(self) -> None:
        """Checks the method, and loads the packaged space where one is needed."""
        check_fields(self, ReachabilityError)
        word = parse_word(JudgeMethod, self.method, "reachability method", ReachabilityError)
        method = JudgeMethod(word)
        object.__setattr__(self, "method", method)
        if method in (JudgeMethod.RMM, JudgeMethod.BOTH) and self.space is None:
            object.__setattr__(self, "space", ReachableSpace.load_named())

    @checked(ReachabilityError)
    def verdicts(self, X_WG: Annotated[ArrayLike, ANY_POSES]) -> NDArray[np.int8]:
        """Verdicts on hand poses (n, 4, 4) in the base frame, places in `VERDICTS`, shape (n,)."""
        if self.method == JudgeMethod.IK:
            return self.reachability.verdicts(X_WG)
        if self.method == JudgeMethod.NONE:
            known = np.isfinite(np.asarray(X_WG)).reshape(-1, 16).all(axis=1)
            return np.where(known, REACHABLE, _UNLIKELY).astype(np.int8)
        assert self.space is not None  # loaded above
        X_WF = self.reachability.flange(X_WG)
        likely = self.space.contains(X_WF)  # not so for NaN
        verdicts = np.where(likely, REACHABLE, _UNLIKELY).astype(np.int8)
        if self.method == JudgeMethod.BOTH and likely.any():
            verdicts[likely] = self.reachability.flange_verdicts(X_WF[likely])
        return verdicts


def _filter(method: JudgeMethod, scenario: Scenario, reachability: Reachability) -> JudgedFilter:
    """The filter of a scenario; modes that enforce nothing skip the approach corridor."""
    config = scenario.reachability
    for name in config.options:
        parse_word(("space", "horizon"), name, "a key of reachability.options", ScenarioError)
    space = ReachableSpace.load_named(str(config.options.get("space", SpaceName.DEFAULT)))
    horizon: Any = config.options.get("horizon", 1.0)
    return JudgedFilter(
        PoseJudge(reachability, method, space),
        horizon=horizon,
        symmetric_grasps=config.symmetric_grasps,
        way_in=WAY_IN if scenario.control.safe else 0.0,
        period=config.period,
    )


#: The values ``rmm``, ``both`` and ``none`` of ``reachability.method``.
density_judge = partial(_filter, JudgeMethod.RMM)
density_and_exact_judge = partial(_filter, JudgeMethod.BOTH)
no_judge = partial(_filter, JudgeMethod.NONE)
