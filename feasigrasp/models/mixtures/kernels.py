"""Density and gradient of a Riemannian mixture at one pose, for compiled code."""

import math
from typing import NamedTuple

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import quaternion_kernel, quaternion_log_kernel


class Parameters(NamedTuple):
    """A Riemannian mixture as the kernels take it.

    Attributes:
        log_weights: Shape (K,); minus infinity for a component that is switched off.
        means: Shape (K, 4, 4) [m].
        quaternions: Of the means, unit, wxyz, shape (K, 4).
        whitening: Inverse of the lower Cholesky factor of each covariance, shape (K, 6, 6).
        log_normalisers: log((2 pi)^-3 |Sigma|^-1/2), shape (K,).
    """

    log_weights: Array
    means: Array
    quaternions: Array
    whitening: Array
    log_normalisers: Array


@compiled
def relative_log_kernel(
    mean: Array,
    m: Array,
    q: tuple[float, float, float, float],
    p: tuple[float, float, float],
) -> tuple[float, float, float, float, float, float]:
    """Log(mean^-1 x) of a pose x with unit quaternion q and position p; m is that of the mean."""
    w = m[0] * q[0] + m[1] * q[1] + m[2] * q[2] + m[3] * q[3]
    x = m[0] * q[1] - m[1] * q[0] - m[2] * q[3] + m[3] * q[2]
    y = m[0] * q[2] - m[2] * q[0] - m[3] * q[1] + m[1] * q[3]
    z = m[0] * q[3] - m[3] * q[0] - m[1] * q[2] + m[2] * q[1]
    sign = math.copysign(1.0, w)
    dx, dy, dz = p[0] - mean[0, 3], p[1] - mean[1, 3], p[2] - mean[2, 3]
    return quaternion_log_kernel(
        sign * w,
        sign * x,
        sign * y,
        sign * z,
        mean[0, 0] * dx + mean[1, 0] * dy + mean[2, 0] * dz,
        mean[0, 1] * dx + mean[1, 1] * dy + mean[2, 1] * dz,
        mean[0, 2] * dx + mean[1, 2] * dy + mean[2, 2] * dz,
    )


@compiled
def evaluate_kernel(
    X: Array, parameters: Parameters, tangents: Array, log_densities: Array
) -> None:
    """Tangents (K, 6) and log densities (K,), without weights, of all components at one pose."""
    _, means, quaternions, whitening, log_normalisers = parameters
    q = quaternion_kernel(X)
    p = (X[0, 3], X[1, 3], X[2, 3])
    for k in range(len(means)):
        v = relative_log_kernel(means[k], quaternions[k], q, p)
        W = whitening[k]
        square = 0.0
        for i in range(6):
            tangents[k, i] = v[i]
            z = 0.0
            for j in range(i + 1):
                z += W[i, j] * tangents[k, j]
            square += z * z
        log_densities[k] = log_normalisers[k] - 0.5 * square


@compiled
def posterior_kernel(log_weights: Array, log_densities: Array, responsibilities: Array) -> float:
    """Writes the responsibilities (K,) and returns the log density of the mixture."""
    largest = -math.inf
    for k in range(len(log_weights)):
        largest = max(largest, log_weights[k] + log_densities[k])
    total = 0.0
    for k in range(len(log_weights)):
        responsibilities[k] = math.exp(log_weights[k] + log_densities[k] - largest)
        total += responsibilities[k]
    for k in range(len(log_weights)):
        responsibilities[k] /= total
    return largest + math.log(total)


@compiled
def evaluate_poses(
    X: Array, parameters: Parameters, tangents: Array, log: Array, r: Array, total: Array
) -> None:
    """Fills tangents, log densities, responsibilities and mixture log densities of n poses."""
    for i in range(len(X)):
        evaluate_kernel(X[i], parameters, tangents[i], log[i])
        total[i] = posterior_kernel(parameters.log_weights, log[i], r[i])
