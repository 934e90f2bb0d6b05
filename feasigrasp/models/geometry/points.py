"""Point sets: spherical Fibonacci points, farthest-point sampling, nearest distances."""

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import wide_vectors


def sphere_points(n: int, radius: float) -> Array:
    """The Fibonacci lattice: n points on a sphere round the origin, shape (n, 3)."""
    i = np.arange(n) + 0.5
    z = 1.0 - 2.0 * i / n
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * i
    rho = np.sqrt(1.0 - z * z)
    return radius * np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], axis=1)


@compiled(forceinline=True, fastmath=True)
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


@compiled(nogil=True)
def farthest_points(points: Array, count: int, outward: int = 0) -> Indices:
    """Indices of ``count`` points (n, 3), each the farthest from those before it.

    Starts with the point farthest from the centroid, so the choice moves with the cloud under
    rigid motions (ties apart) and needs no random numbers.

    A corner can be missed by as much as the spacing of the choice, when a point beside it came
    first. So the first ``outward`` points can be made to prefer what sticks out: for them the
    squared distance is weighted by the fourth power of the distance from the centroid.
    """
    wide_vectors()
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


@compiled(forceinline=True, fastmath=True)
def _least_square(xs: Array, ys: Array, zs: Array, x: float, y: float, z: float) -> float:
    wide_vectors()
    least = 1e30
    for j in range(len(xs)):
        a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
        least = min(least, a * a + b * b + c * c)
    return least


@compiled(nogil=True)
def nearest_distance(points: Array, others: Array) -> Array:
    """Distance from each point (m, 3) to the nearest of the others (k, 3), shape (m,)."""
    wide_vectors()
    xs, ys, zs = others[:, 0].copy(), others[:, 1].copy(), others[:, 2].copy()
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = np.sqrt(_least_square(xs, ys, zs, points[i, 0], points[i, 1], points[i, 2]))
    return out
