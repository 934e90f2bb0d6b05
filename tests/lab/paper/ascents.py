"""The ascent kernel over arrays of poses."""

import numpy as np

from feasigrasp_lab.paper.task_law import ascent_kernel


def ascent_direction(mixture, X):
    """Body displacements (..., 6) [rad, m] of poses (..., 4, 4)."""
    X = np.ascontiguousarray(X, dtype=float)
    out = np.empty((*X.shape[:-2], 6))
    for pose, direction in zip(X.reshape(-1, 4, 4), out.reshape(-1, 6), strict=True):
        ascent_kernel(pose, mixture.parameters, direction)
    return out
