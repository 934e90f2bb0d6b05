"""Riemannian mixture model: Gaussians in tangent spaces of SE(3) (Zeestraten et al. 2017).

They are fitted by :mod:`feasigrasp_lab.mixtures.fit`.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3_kernels import quaternion_kernel, quaternion_log_kernel
from feasigrasp.models.quantities import ANY_POSES, ArrayOf


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


def parameters_of(weights: Array, means: Array, covariances: Array) -> Parameters:
    """The parameters of a mixture, see `RiemannianMixture`.

    Raises:
        LinAlgError: A covariance is not positive definite.
    """
    factors = np.linalg.cholesky(covariances)
    with np.errstate(divide="ignore"):
        log_weights = np.log(weights)
    diagonal = np.diagonal(factors, axis1=1, axis2=2)
    log_normalisers = -3.0 * math.log(2.0 * math.pi) - np.log(diagonal).sum(axis=1)
    whitening = np.tril(np.linalg.inv(factors))
    means = np.ascontiguousarray(means)
    return Parameters(log_weights, means, se3.quaternions(means), whitening, log_normalisers)


@compiled
def relative_log_kernel(
    mean: Array, m: Array, q: tuple[float, float, float, float], p: tuple[float, float, float]
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
def _component_log_densities(X: Array, parameters: Parameters, out: Array) -> None:
    """Writes the log densities (n, K), without weights, of all components at n poses."""
    tangents = np.empty((len(parameters.means), 6))
    for i in range(len(X)):
        evaluate_kernel(X[i], parameters, tangents, out[i])


@compiled
def _log_densities(X: Array, parameters: Parameters, out: Array) -> None:
    """Writes the log densities (n,) of the mixture at n poses."""
    K = len(parameters.means)
    tangents, log, r = np.empty((K, 6)), np.empty(K), np.empty(K)
    for i in range(len(X)):
        evaluate_kernel(X[i], parameters, tangents, log)
        out[i] = posterior_kernel(parameters.log_weights, log, r)


@dataclass(frozen=True, eq=False)
class RiemannianMixture(Frozen):
    """A mixture of Gaussians on SE(3), ``p(x) = sum_i w_i N(Log_mu_i(x); 0, Sigma_i)``.

    ``Log_mu(x) = log(mu^-1 x)`` is the left-invariant tangent vector [angular; linear] at the
    mean (the paper's section III-C), so that moving all means and x together changes nothing.
    The arrays are read-only and a deep copy is the object itself.

    Methods take poses ``X`` of shape (..., 4, 4) and keep the leading axes. Numba code calls the
    kernels of :mod:`feasigrasp_lab.mixtures.mixture` with ``parameters``.

    Attributes:
        weights: Component weights, non-negative, normalised to sum 1, shape (K,). A weight of
            zero switches a component off.
        means: Component means, shape (K, 4, 4) [m].
        covariances: Covariances in the tangent space of each mean, shape (K, 6, 6) [rad, m].

    Raises:
        GraspError: If the shapes disagree, a value is not finite, the weights sum to zero, a
            mean is not a rigid pose, or a covariance is not positive definite.
    """

    weights: Annotated[Array, ArrayOf(("K",))]
    means: Annotated[Array, ArrayOf(("K", 4, 4), "m", rotation=True)]
    covariances: Annotated[Array, ArrayOf(("K", 6, 6))]
    parameters: Parameters = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Checks and freezes the arrays and factorises the covariances once."""
        check_fields(self, GraspError)
        weights, means = self.weights.copy(), self.means.copy()
        covariances = self.covariances.copy()
        if len(weights) == 0:
            raise GraspError("RiemannianMixture: weights is empty; give K >= 1 components.")
        if not ((weights >= 0).all() and weights.sum() > 0):
            raise GraspError(
                f"RiemannianMixture: weights {weights} must be finite, not negative and not all 0."
            )
        weights /= weights.sum()
        try:
            parameters = parameters_of(weights, means, covariances)
        except np.linalg.LinAlgError as error:
            raise GraspError(
                "RiemannianMixture: a covariance is not positive definite; raise the floors."
            ) from error
        for array in parameters:
            array.flags.writeable = False
        self._freeze(weights=weights, means=means, covariances=covariances)
        object.__setattr__(self, "parameters", parameters)

    def __len__(self) -> int:
        """Number of components K."""
        return len(self.weights)

    @checked(GraspError)
    def component_log_densities(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Log of N(x; mu_i, Sigma_i), without the weights, shape (..., K)."""
        X = np.asarray(X)
        out = np.empty((*X.shape[:-2], len(self)))
        _component_log_densities(X.reshape(-1, 4, 4), self.parameters, out.reshape(-1, len(self)))
        return out

    @checked(GraspError)
    def log_density(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Log density of the mixture, shape (...).

        It is finite far from every component, and NaN for a pose that is not finite.
        """
        X = np.asarray(X)
        out = np.empty(X.shape[:-2])
        _log_densities(X.reshape(-1, 4, 4), self.parameters, out.reshape(-1))
        return out


def bic(components: int, poses: int, log_likelihood: float) -> float:
    """Bayesian information criterion of a fitted mixture (Schwarz 1978); lower is better.

    A component has 28 free parameters (weight, mean, covariance); the weights sum to one.
    """
    return (28 * components - 1) * math.log(poses) - 2.0 * log_likelihood
