"""Reachability tests by name: density of reachable poses, or density and exact IK.

The paper calls a pose reachable if its density under a mixture of reachable poses exceeds a
threshold (section IV-B). That is quick and soft: it lets poses through that no configuration
reaches. Exact inverse kinematics decides, with a reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Frozen
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.quantities import ANY_POSES
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.scenario.schema import Scenario
from feasigrasp_lab.paper.judged_filter import JudgedFilter, make_judged_filter
from feasigrasp_lab.paper.reachable_space import ReachableSpace, SpaceName

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
        method = parse_choice(JudgeMethod, self.method, "reachability method", ReachabilityError)
        object.__setattr__(self, "method", method)
        if method in (JudgeMethod.RMM, JudgeMethod.BOTH) and self.space is None:
            object.__setattr__(self, "space", ReachableSpace.load_default())

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
    space = str(scenario.reachability.options.get("space", SpaceName.DEFAULT))
    judge = PoseJudge(reachability, method, ReachableSpace.load_named(space))
    return make_judged_filter(scenario, judge)


#: The values ``rmm``, ``both`` and ``none`` of ``reachability.method``.
density_judge = partial(_filter, JudgeMethod.RMM)
density_and_exact_judge = partial(_filter, JudgeMethod.BOTH)
no_judge = partial(_filter, JudgeMethod.NONE)
