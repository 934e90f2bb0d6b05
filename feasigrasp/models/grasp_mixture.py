"""A Riemannian mixture over grasps that remembers which grasps it was fitted to.

The mean of a component is often no grasp at all. The hand therefore steers to a *member* of a
component: the one closest to it. Unlike the mean, or the most likely member, this target stays the
same when the mixture is fitted anew to a slightly different set of reachable grasps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.grasp_funnel import grasp_errors
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.riemannian_mixture import RiemannianMixture, fit_riemannian_mixture

FloatArray = NDArray[np.float64]

#: Metres that count as much as one radian in comparing hand poses.
LENGTH_PER_RADIAN = 0.1


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
        position, angle = grasp_errors(self.X_OG, X_OH).T
        order = np.argsort(position + LENGTH_PER_RADIAN * angle, kind="stable")
        components, first = np.unique(self.component[order], return_index=True)
        return components, order[first]


def fit_grasp_mixture(
    grasps: GraspSet, n_components: int, rng: np.random.Generator
) -> GraspMixture:
    """Fits a mixture of at most ``n_components`` to at least one grasp."""
    mixture = fit_riemannian_mixture(grasps.X_OG, n_components, rng)
    component = np.argmax(mixture.responsibilities(grasps.X_OG), axis=1)
    return GraspMixture(mixture, grasps.X_OG, component)
