"""Expectation maximization on SE(3), with Riemannian means (Zeestraten et al. 2017).

One compiled pass over the poses yields all that an M step needs: per component the sums of r, r v
and r v v^T, with responsibilities r and tangents v at the mean. Memory does not grow with the
number of poses. The M step moves every mean once, by its mean tangent (generalized EM, Dempster,
Laird, Rubin 1977); over the iterations it gets to where that vanishes.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp_lab.mixtures.mixture import (
    Parameters,
    evaluate_kernel,
    parameters_of,
    posterior_kernel,
)

#: Responsibilities below this are zero: the sums would round them away. Source: numerical.
_NEGLIGIBLE = 1e-16


@compiled
def _add_moments(X: Array, mixture: Parameters, mass: Array, first: Array, second: Array) -> float:
    """Adds the sums of r (K,), r v (K, 6) and the lower triangles of r v v^T (K, 6, 6).

    Returns the log likelihood of the poses (n, 4, 4).
    """
    K = len(mass)
    v, log_densities, r = np.empty((K, 6)), np.empty(K), np.empty(K)
    likelihood = 0.0
    for i in range(len(X)):
        evaluate_kernel(X[i], mixture, v, log_densities)
        likelihood += posterior_kernel(mixture.log_weights, log_densities, r)
        for k in range(K):
            if r[k] < _NEGLIGIBLE:
                continue
            mass[k] += r[k]
            for a in range(6):
                weighted = r[k] * v[k, a]
                first[k, a] += weighted
                for b in range(a + 1):
                    second[k, a, b] += weighted * v[k, b]
    return likelihood


def expectation_maximization(
    X: Array,
    weights: Array,
    means: Array,
    covariances: Array,
    floor: Array,
    max_iterations: int,
    tolerance: float,
) -> tuple[Array, Array, Array, list[float]]:
    """EM from a given mixture.

    Args:
        X: Poses to fit to, shape (n, 4, 4) [m].
        weights: Initial weights, positive, shape (K,).
        means: Initial means, shape (K, 4, 4) [m].
        covariances: Initial covariances, shape (K, 6, 6).
        floor: Variance added to the diagonal of each covariance by each M step, shape (6,).
        max_iterations: Bound on the number of E steps.
        tolerance: Least gain of the log likelihood per pose; with less it ends.

    Returns:
        Weights (K',), means (K', 4, 4), covariances (K', 6, 6) and the log likelihood of every
        E step; K' <= K, since a component of less than one effective pose is dropped.
    """
    history: list[float] = []
    previous = -np.inf
    while len(history) < max_iterations:
        K = len(weights)
        mass, first, second = np.zeros(K), np.zeros((K, 6)), np.zeros((K, 6, 6))
        mixture = parameters_of(weights, means, covariances)
        history.append(_add_moments(X, mixture, mass, first, second))
        starved = int(np.argmin(mass))
        if K > 1 and mass[starved] < 1.0 - 1e-6:
            kept = np.arange(K) != starved
            weights, means, covariances = weights[kept], means[kept], covariances[kept]
            weights = weights / weights.sum()
            previous = -np.inf
            continue
        if history[-1] - previous < tolerance * len(X):
            break
        previous = history[-1]
        step = first / mass[:, None]
        second += np.tril(second, -1).swapaxes(1, 2)
        weights, means = mass / len(X), means @ se3.exp(step)
        covariances = second / mass[:, None, None] - step[:, :, None] * step[:, None, :]
        covariances += np.diag(floor)
    return weights, means, covariances, history
