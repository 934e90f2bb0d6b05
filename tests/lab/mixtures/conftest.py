"""Poses in clusters, and the density of a mixture by SciPy."""

import math

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from feasigrasp.models.geometry import se3


@pytest.fixture(scope="session")
def clusters():
    """``clusters(rng, n, k)``: poses round k well-separated means, their labels, the means."""
    return _clusters


def _clusters(rng, n, k, rotation=0.1, translation=0.01):
    angles = 2 * np.pi * np.arange(k) / k
    means = se3.exp(np.stack([0 * angles, 0 * angles, angles, *np.zeros((3, k))], axis=1))
    means[:, 0, 3] = 0.2 * np.arange(k)
    label = np.arange(n) % k
    std = np.array([rotation] * 3 + [translation] * 3)
    return means[label] @ se3.exp(std * rng.standard_normal((n, 6))), label, means


@pytest.fixture(scope="session")
def numpy_log_density():
    """``numpy_log_density(mixture, X)``: the paper's equation, with SciPy's normal density."""
    return _numpy_log_density


def _numpy_log_density(mixture, X):
    terms = [
        math.log(w) + multivariate_normal(np.zeros(6), S).logpdf(se3.log(np.linalg.inv(mu) @ X))
        for w, mu, S in zip(mixture.weights, mixture.means, mixture.covariances, strict=True)
    ]
    return logsumexp(terms, axis=0)
