"""A Riemannian mixture over grasps that remembers which grasps it was fitted to.

The mean of a component is often no grasp at all. The hand therefore steers to a *member* of a
component: the one closest to it. Unlike the mean, or the most likely member, this target stays the
same when the mixture is fitted anew to a slightly different set of reachable grasps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.grasp_funnel import grasp_errors_kernel
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.riemannian_mixture import RiemannianMixture, fit_riemannian_mixture

FloatArray = NDArray[np.float64]

#: Metres that count as much as one radian in comparing hand poses.
LENGTH_PER_RADIAN = 0.1


@nb.njit(cache=True)
def closest_members_kernel(X_OG, component, X_OH, member):  # type: ignore[no-untyped-def]
    """Writes the index of the grasp of each component that is closest to the hand; -1 for none."""
    closest = np.full(len(member), np.inf)
    member[:] = -1
    errors = np.empty((len(X_OG), 2))
    grasp_errors_kernel(X_OG, X_OH, errors)
    for i in range(len(X_OG)):
        distance = errors[i, 0] + LENGTH_PER_RADIAN * errors[i, 1]
        if distance < closest[component[i]]:
            closest[component[i]] = distance
            member[component[i]] = i


@dataclass(frozen=True, eq=False)
class GraspMixture:
    """A mixture, the grasps it was fitted to, and which component each of them belongs to.

    Attributes:
        mixture: Density over hand poses in the object frame, K components.
        X_OG: The grasps, shape (n, 4, 4) [m].
        component: Most responsible component of each grasp, shape (n,).
    """

    mixture: RiemannianMixture
    X_OG: FloatArray
    component: NDArray[np.intp]

    def __deepcopy__(self, memo: dict[int, Any]) -> GraspMixture:
        """Immutable, so a copy is itself."""
        return self

    def closest_members(self, X_OH: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The grasp of each component that is closest to the hand.

        Args:
            X_OH: Hand pose in the object frame, shape (4, 4).

        Returns:
            Indices of the components that have members, shape (m,), and of those members' grasps,
            shape (m,).
        """
        member = np.empty(len(self.mixture), dtype=np.int64)
        closest_members_kernel(self.X_OG, self.component, np.ascontiguousarray(X_OH), member)
        components = np.flatnonzero(member >= 0)
        return components, member[components]


def fit_grasp_mixture(
    grasps: GraspSet, n_components: int, rng: np.random.Generator
) -> GraspMixture:
    """Fits a mixture of at most ``n_components`` to at least one grasp."""
    # The hand steers to members, not to means: a rough fit does, twenty times a second.
    mixture = fit_riemannian_mixture(
        grasps.X_OG, n_components, rng, max_iterations=5, tolerance=1e-2
    )
    component = np.argmax(mixture.responsibilities(grasps.X_OG), axis=1)
    return GraspMixture(mixture, grasps.X_OG, component)
