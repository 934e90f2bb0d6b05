"""Riemannian mixture over grasps, with the assignment of grasps to components.

The mean of a component is often no grasp at all. Targets of the hand are therefore the medoids: of
each component the most plausible grasp.

The mixture is fitted anew whenever the set of reachable grasps changes. So that a hand which
follows it does not notice, EM goes on from the mixture before, components keep their identity, and
a medoid stays as long as it is about as plausible as the best member.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.grasps.approach_corridor import grasp_errors_kernel
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp_lab.mixtures.fit import fit_best_mixture
from feasigrasp_lab.mixtures.mixture import RiemannianMixture

#: Metres that count as much as one radian in comparing poses. Source: guessed.
LENGTH_PER_RADIAN = 0.1
#: No grasp lies farther than this from all means, so that no component straddles symmetric grasps
#: [rad]. Source: guessed.
MAX_ROTATION = np.deg2rad(75.0)
#: A component is the one before if its mean moved less than this, in metres. Source: guessed.
SAME_COMPONENT = 0.05
#: A mixture explains a grasp whose squared Mahalanobis distance to a component is below this (it is
#: for all but 1 in 25,000 grasps that a component made); if it explains less than half of the
#: grasps, there is nothing to go on from. Source: reasoned.
EXPLAINED = 30.0
#: A medoid gives way to a member that is e to this more plausible. Source: guessed.
MEDOID_HYSTERESIS = 1.0


@dataclass(frozen=True, eq=False)
class GraspMixture(Frozen):
    """A mixture, the grasps it was fitted to, and which component each of them belongs to.

    Attributes:
        mixture: Density over hand poses in the object frame, K components.
        X_OG: The grasps, shape (n, 4, 4) [m].
        component: Most responsible component of each grasp, shape (n,).
        medoid: Index of the grasp that stands for each component, shape (K,).
        identity: A number that stays with a component through refits, shape (K,).
        targets: The mixture with its means moved to the medoids: its maxima are grasps.
    """

    mixture: RiemannianMixture
    X_OG: Array
    component: Indices
    medoid: Indices
    identity: Indices
    targets: RiemannianMixture = field(init=False)

    def __post_init__(self) -> None:
        """Moves the means to the medoids."""
        targets = RiemannianMixture(
            self.mixture.weights, self.X_OG[self.medoid], self.mixture.covariances
        )
        object.__setattr__(self, "targets", targets)


def fit_grasp_mixture(
    grasps: GraspSet,
    max_components: int,
    rng: np.random.Generator,
    previous: GraspMixture | None = None,
) -> GraspMixture:
    """Fits a mixture to at least one grasp, with as many components as BIC asks for.

    Args:
        grasps: Hand poses in the object frame. A grasp and its 180-degree flip are two of them,
            which never share a component.
        max_components: Most components.
        rng: Source of randomness of the seeds.
        previous: The mixture before, which EM starts from.
    """
    start = None
    if previous is not None and _explains(previous.mixture, grasps.X_OG):
        start = previous.mixture
    mixture = fit_best_mixture(
        grasps.X_OG, rng, max_components, start=start, max_rotation=MAX_ROTATION
    )
    log_density = mixture.component_log_densities(grasps.X_OG)
    component = np.argmax(log_density + mixture.parameters[0], axis=1)
    # The most plausible member: likely, and of a high score.
    plausible = log_density + np.log(np.maximum(grasps.score, 1e-3))[:, None]
    plausible[component[:, None] != np.arange(len(mixture))] -= 1e3
    if previous is None:
        medoid, identity = np.argmax(plausible, axis=0), np.arange(len(mixture))
        return GraspMixture(mixture, grasps.X_OG, component, medoid, identity)
    identity, before = _identities(mixture, previous)
    for k in np.flatnonzero(before >= 0):
        X_OM = previous.X_OG[previous.medoid[before[k]]]
        stays = np.abs(grasps.X_OG - X_OM).max(axis=(1, 2)) < 1e-9
        plausible[stays, k] += MEDOID_HYSTERESIS
    return GraspMixture(mixture, grasps.X_OG, component, np.argmax(plausible, axis=0), identity)


def _explains(mixture: RiemannianMixture, X_OG: Array) -> bool:
    """Whether at least half of the grasps are where the mixture expects some."""
    log_normalisers = mixture.parameters[4]
    squares = 2.0 * (log_normalisers - mixture.component_log_densities(X_OG))
    return bool(np.median(squares.min(axis=1)) < EXPLAINED)


def _identities(mixture: RiemannianMixture, previous: GraspMixture) -> tuple[Indices, Indices]:
    """Identities (K,) of components, and which one of the previous each of them was; -1 for none.

    The closest pairs of means are matched first; what is left gets new numbers.
    """
    distance = np.empty((len(mixture), len(previous.mixture)))
    for i, mean in enumerate(mixture.means):
        errors = np.empty((len(previous.mixture), 2))
        grasp_errors_kernel(previous.mixture.means, mean, errors)
        distance[i] = errors[:, 0] + LENGTH_PER_RADIAN * errors[:, 1]
    before = np.full(len(mixture), -1)
    while distance.min() < SAME_COMPONENT:
        k, j = np.unravel_index(np.argmin(distance), distance.shape)
        before[k] = j
        distance[k], distance[:, j] = np.inf, np.inf
    identity = np.where(before >= 0, previous.identity[before], -1)
    new = np.flatnonzero(before < 0)
    identity[new] = previous.identity.max() + 1 + np.arange(len(new))
    return identity, before


@dataclass(frozen=True, eq=False)
class MixtureMemory(Frozen):
    """The mixture over the present grasps, from one update to the next.

    Attributes:
        mixture: None without grasps.
        last: The last mixture there was, so that grasps that come back find it again.
    """

    mixture: GraspMixture | None = None
    last: GraspMixture | None = None

    def with_grasps(self, grasps: GraspSet, max_components: int, seed: int) -> MixtureMemory:
        """The memory with the mixture over ``grasps``, refitted if they have changed.

        Args:
            grasps: Hand poses in the object frame.
            max_components: Most components.
            seed: Of the random numbers of a fit.
        """
        if len(grasps) == 0:
            return MixtureMemory(last=self.last)
        mixture = self.mixture or self.last
        if mixture is None or mixture.X_OG is not grasps.X_OG:
            rng = np.random.default_rng(seed)
            mixture = fit_grasp_mixture(grasps, max_components, rng, mixture)
        return MixtureMemory(mixture, mixture)
