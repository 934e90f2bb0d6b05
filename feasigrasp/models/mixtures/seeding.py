"""Where the components of a mixture on SE(3) start: greedy k-means++ seeding."""

import math

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled

#: Squared distance [rad^2] under which a pose counts as a duplicate of a seed.
_DUPLICATE = 1e-12


@compiled
def seed_means(
    quaternions: Array, positions: Array, weights: Array, length_scale: float, draws: Array
) -> tuple[Indices, float]:
    """Greedy k-means++ in the metric angle^2 + (distance / length_scale)^2.

    Args:
        quaternions: Unit quaternions, shape (4, n).
        positions: Positions, shape (3, n) [m].
        weights: Weight of each pose, shape (n,).
        length_scale: Metres that weigh as much as a radian.
        draws: Uniform variates in [0, 1), shape (K, candidates): the randomness.

    Returns:
        Indices of at most K distinct seeds, and the root mean square distance to the nearest
        seed per tangent dimension [rad].
    """
    n, k = len(weights), len(draws)
    seeds = np.empty(k, dtype=np.int64)
    nearest = np.full(n, np.inf)
    candidate, best = np.empty(n), np.empty(n)
    count, potential = 0, np.inf
    for i in range(k):
        if i > 0 and potential <= _DUPLICATE * n:
            break
        lowest = np.inf
        for j in range(draws.shape[1]):
            index = _draw(weights, nearest, draws[i, j], i == 0)
            _squared_distances(quaternions, positions, index, length_scale, candidate)
            total = 0.0
            for m in range(n):
                candidate[m] = min(candidate[m], nearest[m])
                total += weights[m] * candidate[m]
            if total < lowest:
                lowest, seeds[i] = total, index
                candidate, best = best, candidate
        nearest, best = best, nearest
        potential, count = lowest, i + 1
    return seeds[:count], math.sqrt(potential / 6.0 / len(weights))


@compiled
def _draw(weights: Array, nearest: Array, uniform: float, first: bool) -> int:
    """Index drawn with probability weight (times squared distance after the first seed)."""
    total = 0.0
    for i in range(len(weights)):
        total += weights[i] * (1.0 if first else nearest[i])
    target, chosen, reached = uniform * total, 0, 0.0
    for i in range(len(weights)):
        mass = weights[i] * (1.0 if first else nearest[i])
        if mass > 0.0:
            chosen = i
            reached += mass
            if reached > target:
                break
    return chosen


@compiled
def _squared_distances(q: Array, p: Array, index: int, length_scale: float, out: Array) -> None:
    scale = 1.0 / length_scale**2
    for i in range(len(out)):
        cosine = 0.0
        for j in range(4):
            cosine += q[j, i] * q[j, index]
        angle = 2.0 * math.acos(min(1.0, abs(cosine)))
        square = 0.0
        for j in range(3):
            square += (p[j, i] - p[j, index]) ** 2
        out[i] = angle * angle + scale * square
