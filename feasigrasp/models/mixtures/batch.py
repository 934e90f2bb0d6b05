"""Exact log densities of many poses: SIMD over blocks, in double precision."""

import math

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3_kernels import quaternion_kernel
from feasigrasp.models.mixtures.em import BLOCK, block_log_density, block_tangents
from feasigrasp.models.mixtures.kernels import Parameters
from feasigrasp.models.numerics.fast_math import fast_exp


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc"})
def _add_exponentials(row: Array, largest: Array, total: Array) -> None:
    for j in range(BLOCK):
        total[j] += fast_exp(row[j] - largest[j])


@njit(cache=True, error_model="numpy")
def log_densities(X: Array, parameters: Parameters, out: Array) -> None:
    """Log densities (n,) of poses (n, 4, 4): what `evaluate_poses` says, several times faster.

    NaN for a pose that is not finite.
    """
    log_weights, means, _, whitening, log_normalisers = parameters
    K = len(means)
    block, tangents = np.empty(7 * BLOCK), np.empty(6 * BLOCK)
    log_density, largest, total = np.empty((K, BLOCK)), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, len(X), BLOCK):
        n = min(BLOCK, len(X) - start)
        for j in range(BLOCK):  # the last block is filled up with copies of the last pose
            pose = X[start + min(j, n - 1)]
            q = quaternion_kernel(pose)
            for a in range(4):
                block[a * BLOCK + j] = q[a]
            for a in range(3):
                block[(4 + a) * BLOCK + j] = pose[a, 3]
        largest[:], total[:] = -np.inf, 0.0
        for k in range(K):
            block_tangents(block, means[k], tangents)
            constant = log_weights[k] + log_normalisers[k]
            block_log_density(tangents, whitening[k], constant, log_density[k])
            for j in range(BLOCK):
                largest[j] = max(largest[j], log_density[k, j])
        for k in range(K):
            _add_exponentials(log_density[k], largest, total)
        for j in range(n):
            size = 0.0
            for a in range(7):
                size += block[a * BLOCK + j]
            value = largest[j] + math.log(total[j])
            out[start + j] = value if math.isfinite(size) else math.nan
