"""The ascent kernel, and the parts of a mixture by their formulas, over arrays of poses."""

import numpy as np
from scipy.special import softmax

from feasigrasp.models.geometry import se3
from feasigrasp_lab.paper.task_law import ascent_kernel


def ascent_direction(mixture, X, gradient=False):
    """Body displacements, or gradients, (..., 6) [rad, m] at poses (..., 4, 4)."""
    X = np.ascontiguousarray(X, dtype=float)
    out = np.empty((*X.shape[:-2], 6))
    for pose, direction in zip(X.reshape(-1, 4, 4), out.reshape(-1, 6), strict=True):
        ascent_kernel(pose, mixture.parameters, gradient, direction)
    return out


def tangents(mixture, X):
    """Log_mu_i(x), shape (..., K, 6)."""
    return se3.log(se3.inverse(mixture.means) @ X[..., None, :, :])


def responsibilities(mixture, X):
    """Probability that each component made x, shape (..., K)."""
    return softmax(mixture.component_log_densities(X) + mixture.parameters[0], axis=-1)
