"""Riemannian mixture model: Gaussians in tangent spaces of SE(3) (Zeestraten et al. 2017).

They are fitted by :mod:`feasigrasp.models.mixtures.fit`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.geometry import se3
from feasigrasp.models.mixtures.kernels import Parameters, evaluate_poses
from feasigrasp.models.quantities import ANY_POSES, POSES, ArrayOf


@dataclass(frozen=True, eq=False)
class RiemannianMixture(Frozen):
    """A mixture of Gaussians on SE(3), ``p(x) = sum_i w_i N(Log_mu_i(x); 0, Sigma_i)``.

    ``Log_mu(x) = log(mu^-1 x)`` is the left-invariant tangent vector [angular; linear] at the
    mean (the paper's section III-C), so that moving all means and x together changes nothing.
    The arrays are read-only and a deep copy is the object itself.

    Methods take poses ``X`` of shape (..., 4, 4) and keep the leading axes: one pose (4, 4) at
    the control rate (a few microseconds), (n, 4, 4) for a set. Numba code calls the kernels of
    :mod:`feasigrasp.models.mixtures.kernels` with ``parameters``.

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
            factors = np.linalg.cholesky(covariances)
        except np.linalg.LinAlgError as error:
            raise GraspError(
                "RiemannianMixture: a covariance is not positive definite; raise the floors."
            ) from error
        with np.errstate(divide="ignore"):
            log_weights = np.log(weights)
        diagonal = np.diagonal(factors, axis1=1, axis2=2)
        log_normalisers = -3.0 * math.log(2.0 * math.pi) - np.log(diagonal).sum(axis=1)
        whitening = np.tril(np.linalg.inv(factors))
        parameters = Parameters(
            log_weights, means, se3.quaternions(means), whitening, log_normalisers
        )
        for array in parameters:
            array.flags.writeable = False
        self._freeze(weights=weights, means=means, covariances=covariances)
        object.__setattr__(self, "parameters", parameters)

    def __len__(self) -> int:
        """Number of components K."""
        return len(self.weights)

    @checked(GraspError)
    def tangents(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Log_mu_i(x), shape (..., K, 6) [rad, m]."""
        return self._evaluate(X)[0]

    @checked(GraspError)
    def component_log_densities(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Log of N(x; mu_i, Sigma_i), without the weights, shape (..., K)."""
        return self._evaluate(X)[1]

    @checked(GraspError)
    def responsibilities(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Probability that each component made x, shape (..., K); sums to 1 at any distance."""
        return self._evaluate(X)[2]

    @checked(GraspError)
    def log_density(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Log density of the mixture, shape (...); finite far from every component."""
        return self._evaluate(X)[3]

    @checked(GraspError)
    def log_density_gradient(self, X: Annotated[ArrayLike, ANY_POSES]) -> Array:
        """Gradient of the log density for a body perturbation ``x exp(eps)``, shape (..., 6).

        ``sum_i r_i J_r^-T(xi_i) (-Sigma_i^-1 xi_i)`` with ``xi_i = Log_mu_i(x)``. The paper prints
        ``J_r^-1(mu^-1)`` instead (section IV-D.1), which disagrees with finite differences.
        """
        tangents, r = self.tangents(X), self.responsibilities(X)
        W = self.parameters.whitening
        pulls = np.einsum("kji,kjl,...kl->...ki", W, W, tangents)
        J = se3.right_jacobian_inverse(tangents)
        return np.asarray(-np.einsum("...k,...kji,...kj->...i", r, J, pulls))

    @checked(GraspError)
    def medoids(self, X_samples: Annotated[ArrayLike, POSES]) -> NDArray[np.intp]:
        """Index of the most likely of the samples (n, 4, 4) under each component, shape (K,)."""
        if len(np.asarray(X_samples)) == 0:
            raise GraspError("medoids: X_samples is empty; give one pose or more")
        return np.asarray(np.argmax(self.component_log_densities(X_samples), axis=0))

    def _evaluate(self, X: ArrayLike) -> tuple[Array, Array, Array, Array]:
        X = np.asarray(X)
        lead, X = X.shape[:-2], X.reshape(-1, 4, 4)
        n, k = len(X), len(self)
        out = np.empty((n, k, 6)), np.empty((n, k)), np.empty((n, k)), np.empty(n)
        evaluate_poses(X, self.parameters, *out)
        return (
            out[0].reshape(*lead, k, 6),
            out[1].reshape(*lead, k),
            out[2].reshape(*lead, k),
            out[3].reshape(lead),
        )


def bic(components: int, poses: int, log_likelihood: float) -> float:
    """Bayesian information criterion of a fitted mixture (Schwarz 1978); lower is better.

    A component has 28 free parameters (weight, mean, covariance); the weights sum to one.
    """
    return (28 * components - 1) * math.log(poses) - 2.0 * log_likelihood
