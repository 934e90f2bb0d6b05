"""Judging hand poses: the paper's density, exact inverse kinematics, or one after the other.

The paper calls a pose reachable if its density under a mixture of reachable poses exceeds a
threshold (section IV-B). That is quick and soft: it lets poses through that no configuration
reaches. Exact inverse kinematics knows, and knows why not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.reach.kernels import REACHABLE
from feasigrasp.models.reach.reachability import VERDICTS, Reachability
from feasigrasp.models.reach.reachable_space import ReachableSpace

#: ``ik``: exact. ``rmm``: the paper's. ``both``: the paper's, and exact on what passes.
METHODS = ("ik", "rmm", "both")

UNLIKELY = 5
#: What `PoseJudge.verdicts` says, by code.
REASONS = {**VERDICTS, UNLIKELY: "unlikely under the reachable-space mixture"}


@dataclass(frozen=True, eq=False)
class PoseJudge:
    """Says which hand poses can be reached, and why the others cannot.

    Attributes:
        reachability: Exact inverse kinematics; its gripper tells where the flange is.
        method: One of `METHODS`.
        space: Density of reachable flange poses, for ``rmm`` and ``both``; the packaged one of the
            iiwa if not given.

    Raises:
        ReachabilityError: There is no such method.
    """

    reachability: Reachability
    method: str = "ik"
    space: ReachableSpace | None = None

    def __post_init__(self) -> None:
        """Checks the method, and loads the packaged space where one is needed."""
        if self.method not in METHODS:
            raise ReachabilityError(
                f"reachability method {self.method!r}; choose one of {', '.join(METHODS)}"
            )
        if self.method != "ik" and self.space is None:
            object.__setattr__(self, "space", ReachableSpace.load_default())

    def verdicts(self, X_WG: ArrayLike) -> NDArray[np.int8]:
        """Verdicts on hand poses (n, 4, 4) in the base frame, keys of `REASONS`, shape (n,)."""
        if self.method == "ik":
            return self.reachability.verdicts(X_WG)
        assert self.space is not None  # loaded above
        X_WF = self.reachability.flange(X_WG)
        likely = self.space.contains(X_WF)  # not so for NaN
        verdicts = np.where(likely, REACHABLE, UNLIKELY).astype(np.int8)
        if self.method == "both" and likely.any():
            verdicts[likely] = self.reachability.flange_verdicts(X_WF[likely])
        return verdicts
