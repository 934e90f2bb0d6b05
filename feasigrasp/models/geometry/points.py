"""A choice of points that covers a cloud."""

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.numerics.simd import wide_vectors


@njit(cache=True, fastmath=True, error_model="numpy")
def _lower_to(
    nearest: Array, xs: Array, ys: Array, zs: Array, x: float, y: float, z: float
) -> float:
    """Lowers the squared distances to the nearest chosen point by a new one; the largest left.

    The maximum is one of bit patterns, which are ordered as positive numbers are: only that of
    integers is vectorised.
    """
    wide_vectors()
    largest = np.int64(0)
    for j in range(len(nearest)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        square = min(nearest[j], a * a + b * b + c * c)
        nearest[j] = square
        largest = max(largest, np.float64(square).view(np.int64))
    return np.int64(largest).view(np.float64)


@njit(cache=True, nogil=True)
def farthest_points(points: Array, count: int, outward: int = 0) -> Indices:
    """Indices of ``count`` points (n, 3), each the farthest from those before it.

    Starts with the point farthest from the centroid, so the choice moves with the cloud under
    rigid motions (ties apart) and needs no random numbers.

    A corner can be missed by as much as the spacing of the choice, when a point beside it came
    first. So the first ``outward`` points can be made to prefer what sticks out: for them the
    squared distance is weighted by the fourth power of the distance from the centroid.
    """
    n = len(points)
    xs, ys, zs = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    nearest = np.full(n, np.inf)
    chosen = np.empty(count, dtype=np.int64)
    x, y, z = xs.mean(), ys.mean(), zs.mean()
    _lower_to(nearest, xs, ys, zs, x, y, z)
    weight = nearest * nearest
    best = int(np.argmax(nearest))
    nearest[:] = np.inf
    for i in range(count):
        chosen[i] = best
        if i == count - 1:
            break
        largest = _lower_to(nearest, xs, ys, zs, xs[best], ys[best], zs[best])
        if i + 1 < outward:
            best = int(np.argmax(nearest * weight))
        else:
            best = 0
            while best < n - 1 and nearest[best] != largest:
                best += 1
    return chosen
