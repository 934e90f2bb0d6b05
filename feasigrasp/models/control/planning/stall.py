"""Stall detection: grasps that the hand comes no nearer to are blocked for a while.

The hand goes for grasps with a probability of 0.5 and a sufficient payload score. While none is in
reach, both thresholds decay exponentially; they recover at the same rate.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Mask
from feasigrasp.models.control.planning.clearance_schedule import LEVER
from feasigrasp.models.grasps.approach_corridor import grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import filter_by_score
from feasigrasp.models.grasps.payload import filter_by_payload

#: Time constant of the thresholds [s]. Chosen on seeds 4 and 5 of ReachCircular by camera: with 10
#: s hands waited where 2 s let them come near and see more. Source: measured.
_TIME_CONSTANT = 2.0
#: Grasps this near to a blocked one [m], [rad] are blocked with it; duration of that [s]. Source:
#: guessed.
_LIKE_IT, _FORGOTTEN = np.array([0.03, 0.5]), 15.0


@dataclass(frozen=True, eq=False)
class Attempt(Frozen):
    """Progress of the hand towards its grasps, for stall detection.

    Attributes:
        left: Least way to a grasp until now [m]; infinite at first.
        since: When it was as little for the first time [s], later by the time without a grasp.
        time: When this was so [s].
        relaxation: Time without a good grasp, less the time with one; not negative [s].
        given_up: Grasps that the hand did not come by, in O, shape (k, 4, 4) [m].
        given_up_at: When they were given up, shape (k,) [s].
    """

    left: float = np.inf
    since: float = np.nan
    time: float = np.nan
    relaxation: float = 0.0
    given_up: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    given_up_at: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def least(self) -> float:
        """Least `GraspSet.payload_score`, and least share of even odds, of a usable grasp."""
        return float(np.exp(-self.relaxation / _TIME_CONSTANT))

    def usable(self, grasps: GraspSet) -> GraspSet:
        """The grasps that are not given up, and good enough."""
        grasps = _as_good(grasps, self.least)
        kept = self._left_of(grasps)
        return grasps if kept.all() else grasps.select(np.flatnonzero(kept))

    def _left_of(self, grasps: GraspSet) -> Mask:
        """Which of the grasps are not given up, shape (n,)."""
        kept = np.ones(len(grasps), dtype=bool)
        for X_OG in self.given_up:
            kept &= np.max(grasp_errors(grasps.X_OG, X_OG) / _LIKE_IT, axis=1) > 1.0
        return kept

    def interrupted(self, time: float) -> Self:
        """The attempt during a gap without data."""
        return replace(self, left=np.inf, since=np.nan, time=time)

    def _relaxed(self, time: float, grasps: GraspSet) -> Self:
        """The same at a time, with its relaxation.

        Thresholds that recovered at once would make grasps near them come and go.
        """
        since = 0.0 if np.isnan(self.time) else time - self.time
        good = self._left_of(_as_good(grasps, 1.0)).any()
        relaxation = max(0.0, self.relaxation - since) if good else self.relaxation + since
        return replace(self, time=time, relaxation=relaxation)

    def advanced(self, time: float, X_OH: Array, grasps: GraspSet, patience: float) -> Self:
        """The attempt at a time [s], with the hand at ``X_OH`` (4, 4) [m] and grasps given to it.

        Without progress for the time ``patience`` [s], the nearest grasp is given up.
        """
        lasting = time - self.given_up_at < _FORGOTTEN
        now = replace(self, given_up=self.given_up[lasting], given_up_at=self.given_up_at[lasting])
        now = now._relaxed(time, grasps)
        usable = now.usable(grasps)
        if len(usable) == 0:
            # Grasps that come and go do not make the hand get on.
            return replace(now, since=now.since + time - self.time)
        ways = grasp_errors(usable.X_OG, X_OH) @ [1.0, LEVER]
        # The hand gets on if the way becomes so much shorter [m], or by this share of it; guessed.
        progress = min(0.02, 0.3 * now.left)
        if now.left == np.inf or ways.min() < now.left - progress:
            return replace(now, left=float(ways.min()), since=time)
        if time - now.since < patience:
            return now
        nearest = usable.X_OG[int(ways.argmin())]
        return replace(
            now,
            left=np.inf,
            since=time,
            given_up=np.concatenate([now.given_up, nearest[None]]),
            given_up_at=np.append(now.given_up_at, time),
        )


def _as_good(grasps: GraspSet, least: float) -> GraspSet:
    """The grasps with at least this payload score and this share of a probability of 0.5."""
    return filter_by_score(filter_by_payload(grasps, least), least)
