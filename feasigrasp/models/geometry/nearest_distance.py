"""Distances to the nearest of some points, where a tree would not pay."""

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array
from feasigrasp.models.numerics.simd import wide_vectors


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _least_square(xs: Array, ys: Array, zs: Array, x: float, y: float, z: float) -> float:
    wide_vectors()
    least = 1e30
    for j in range(len(xs)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        least = min(least, a * a + b * b + c * c)
    return least


@njit(cache=True, nogil=True)
def nearest_distance(points: Array, others: Array) -> Array:
    """Distance from each point (m, 3) to the nearest of the others (k, 3), shape (m,)."""
    xs, ys, zs = others[:, 0].copy(), others[:, 1].copy(), others[:, 2].copy()
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = np.sqrt(_least_square(xs, ys, zs, points[i, 0], points[i, 1], points[i, 2]))
    return out
