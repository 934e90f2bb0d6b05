"""State of the task-space controller between two updates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.control.task.choice import (
    ChoiceOptions,
    GraspChoice,
    choose_grasp,
    present_index,
)
from feasigrasp.models.control.task.grasp_mixture import GraspMixture, fit_grasp_mixture
from feasigrasp.models.grasps.grasp_set import UNKNOWN, GraspSet
from feasigrasp.models.reach.reachability import Reachability

#: How long a grasp of the object can still be followed after it has left the set [s]. It mostly
#: leaves because it will be out of reach before long: no reason to drop everything at once. Source:
#: reasoned.
GRACE = 1.0


@dataclass(frozen=True, eq=False)
class TaskMemory(Frozen):
    """The mixture over the present grasps, and the grasp that is followed.

    Attributes:
        mixture: None without grasps.
        grasps: Those it was fitted to.
        choice: False if no grasp can be reached.
        last: The last mixture there was, so that grasps that come back find it again.
        seen: When the grasp followed was last among the grasps [s].
        followed: Its id.
    """

    mixture: GraspMixture | None = None
    grasps: GraspSet = field(default_factory=GraspSet.empty)
    choice: GraspChoice = field(default_factory=GraspChoice)
    last: GraspMixture | None = None
    seen: float = -np.inf
    followed: int = UNKNOWN

    def with_grasps(self, grasps: GraspSet, max_components: int, seed: int) -> TaskMemory:
        """The memory with the mixture over ``grasps``, refitted if they have changed.

        Args:
            grasps: Hand poses in the object frame.
            max_components: Most components.
            seed: Of a fit from scratch.
        """
        if len(grasps) == 0:
            return replace(self, mixture=None, grasps=grasps)
        mixture = self.mixture or self.last
        if mixture is None or mixture.X_OG is not grasps.X_OG:
            mixture = fit_grasp_mixture(
                grasps, max_components, np.random.default_rng(seed), mixture
            )
        return replace(self, mixture=mixture, grasps=grasps, last=mixture)

    def with_choice(
        self,
        time: float,
        q: Array,
        X_WO_predicted: Array,
        reachability: Reachability,
        options: ChoiceOptions,
        *,
        committed: bool = False,
    ) -> TaskMemory:
        """The memory with the choice confirmed or changed.

        A grasp that is none any more, on the observed surface, is dropped.

        Args:
            time: Present time [s].
            q: Joint positions [rad], shape (7,).
            X_WO_predicted: Poses of the object at the instants of the plan, see `choose_grasp`,
                shape (K + 1, 4, 4).
            reachability: Test of configurations.
            options: Horizon and cost weights.
            committed: Whether the hand is closing, or has closed, on the one grasp there is.
        """
        X_OG, rates, seen = self.grasps.X_OG, np.zeros(0), self.seen
        if self.mixture is not None:
            rates = options.costs.grasp_rates(self.grasps, self.mixture.mixture.log_density(X_OG))
        if self.choice:
            if present_index(self.choice, X_OG) >= 0:
                seen = time
            elif not committed and time <= seen + GRACE and self._is_still_one():
                X_OG = np.concatenate([X_OG, self.choice.X_OG[None]])
                rates = np.append(rates, self.choice.rate)
        choice = choose_grasp(
            *(self.choice, time, q, X_OG, rates, X_WO_predicted, reachability, options),
            committed=committed,
        )
        if choice.count != self.choice.count:
            seen = time
        index = present_index(choice, self.grasps.X_OG)
        followed = int(self.grasps.id[index]) if index >= 0 else self.followed
        return replace(self, choice=choice, seen=seen, followed=followed)

    def _is_still_one(self) -> bool:
        """Whether the grasp followed is still a grasp on the observed surface."""
        known = self.grasps.on_object
        return known is None or self.followed in known
