"""Distance field over joint configurations (paper section IV-D.2).

The same Gaussian process as for shapes, with the kernel ``exp(-|q - q_i| / l)``, over the inverse
kinematics solutions q_i of many grasps: its distance ``d = -l ln o`` is a potential with one
equilibrium per solution. The length scale follows the spacing of the solutions, since neighbours
that are closer than l blend into one equilibrium that is no solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Bounds of the length scale [rad], and its ratio to the median nearest-neighbour spacing.
MIN_LENGTH_SCALE, MAX_LENGTH_SCALE, SPACING_RATIO = 0.03, 0.2, 0.4


@nb.njit(cache=True)
def _distances(q):  # type: ignore[no-untyped-def]
    n = len(q)
    distance = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            square = 0.0
            for k in range(7):
                square += (q[i, k] - q[j, k]) ** 2
            distance[i, j] = distance[j, i] = np.sqrt(square)
    return distance


@nb.njit(cache=True)
def _length_scale(distance):  # type: ignore[no-untyped-def]
    n = len(distance)
    nearest = np.full(n, np.inf)
    for i in range(n):
        for j in range(n):
            if i != j:
                nearest[i] = min(nearest[i], distance[i, j])
    return min(max(SPACING_RATIO * np.median(nearest), MIN_LENGTH_SCALE), MAX_LENGTH_SCALE)


@nb.njit(cache=True)
def _weights(distance, length_scale, noise_variance):  # type: ignore[no-untyped-def]
    """(K + s2 I)^-1 1."""
    K = np.exp(-distance / length_scale)
    for i in range(len(K)):
        K[i, i] += noise_variance
    return np.linalg.solve(K, np.ones(len(K)))


def spacing_length_scale(q: FloatArray) -> float:
    """Clip(0.4 x median nearest-neighbour distance, 0.03, 0.2) [rad] for q, shape (n, 7)."""
    if len(q) < 2:
        return MAX_LENGTH_SCALE
    return _length_scale(_distances(q))


@dataclass(frozen=True, eq=False)
class JointField:
    """Distance field over configurations.

    Attributes:
        q: Configurations at distance zero, shape (n, 7) [rad].
        alpha: Weights ``(K + s2 I)^-1 1``, shape (n,).
        length_scale: l [rad].
    """

    q: FloatArray
    alpha: FloatArray
    length_scale: float

    def evaluate(self, q: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Distance, its gradient, and how much each solution counts, at one configuration.

        The occupancy is evaluated relative to its largest term, so that nothing underflows far
        from all solutions (o itself is exp(-100) at 3 rad with l = 0.03).

        Args:
            q: Joint positions [rad], shape (7,).

        Returns:
            d [rad]; grad d, shape (7,); non-negative weights of the solutions, summing to 1,
            shape (n,).
        """
        offset = q - self.q
        r = np.sqrt(np.einsum("ij,ij->i", offset, offset))
        nearest = float(r.min())
        decay = np.exp((nearest - r) / self.length_scale)
        terms = self.alpha * decay
        o = float(terms.sum())
        weights = decay / decay.sum()
        if o <= 0.0:
            # Noise-free weights keep o positive; guard against a nearly singular K all the same.
            terms, o = weights, 1.0
        d = nearest - self.length_scale * np.log(o)
        gradient = (terms / np.maximum(r, 1e-12)) @ offset / o
        return float(d), gradient, weights


def fit_joint_field(
    q: FloatArray, length_scale: float | None = None, noise_variance: float = 1e-6
) -> JointField:
    """Fits the field to configurations q, shape (n, 7) [rad]; l from their spacing by default."""
    q = np.array(q, dtype=float).reshape(-1, 7)
    if len(q) == 0:
        raise ValueError("a joint field needs at least one configuration; got none")
    distance = _distances(q)
    if length_scale is None:
        length_scale = _length_scale(distance) if len(q) > 1 else MAX_LENGTH_SCALE
    return JointField(q, _weights(distance, length_scale, noise_variance), length_scale)
