"""Compiled loops of the Gaussian process distance field (see ``gpdf``).

Nodes are centred and stored as ``(3, n)``, coordinate by coordinate, so that the inner loops
vectorise (``fastmath`` lets sums be reordered and assumes finite numbers: callers check). No
function builds an ``m x n`` matrix except the two that return one.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from feasigrasp.models.fast_exp import fast_exp

Array = NDArray[np.float64]

#: Far away or deep inside, occupancy underflows; it is guarded below, never clamped at 1.
MIN_OCCUPANCY = 1e-30
#: Floor on |grad d| in the damped Newton step.
SLOPE_FLOOR = 0.2
#: Keeps 1/r finite at a node, where the summand of the gradient is 0.
_TINY = 1e-30


@njit(cache=True, fastmath=True, error_model="numpy")
def gram_lower(nodes: Array, length_scale: float, noise_variance: float) -> Array:
    """Lower triangle of ``K + s2 I``, transposed, shape ``(n, n)``.

    Filled row by row; its ``.T`` is the lower triangle in the Fortran order that LAPACK wants.
    """
    n = nodes.shape[1]
    transposed = np.zeros((n, n))
    inverse = -1.0 / length_scale
    for j in range(n):
        x, y, z = nodes[0, j], nodes[1, j], nodes[2, j]
        row = transposed[j]
        for i in range(j, n):
            a, b, c = nodes[0, i] - x, nodes[1, i] - y, nodes[2, i] - z
            row[i] = fast_exp(np.sqrt(a * a + b * b + c * c) * inverse)
        row[j] = 1.0 + noise_variance
    return transposed


@njit(cache=True, fastmath=True, error_model="numpy")
def cross_covariance(nodes: Array, length_scale: float, points: Array) -> Array:
    """``k(x_i, X_j)``, shape ``(m, n)``."""
    n = nodes.shape[1]
    out = np.empty((len(points), n))
    inverse = -1.0 / length_scale
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        row = out[i]
        for j in range(n):
            a, b, c = nodes[0, j] - x, nodes[1, j] - y, nodes[2, j] - z
            row[j] = fast_exp(np.sqrt(a * a + b * b + c * c) * inverse)
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def value_at(
    nodes: Array, alpha: Array, length_scale: float, x: float, y: float, z: float
) -> float:
    """Raw distance ``d = -l ln o`` at one point."""
    inverse = -1.0 / length_scale
    o = 0.0
    for j in range(nodes.shape[1]):
        a, b, c = x - nodes[0, j], y - nodes[1, j], z - nodes[2, j]
        o += alpha[j] * fast_exp(np.sqrt(a * a + b * b + c * c) * inverse)
    return -length_scale * np.log(max(o, MIN_OCCUPANCY))


@njit(cache=True, fastmath=True, error_model="numpy")
def value_and_gradient_at(
    nodes: Array, alpha: Array, length_scale: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Raw distance and its gradient ``grad d = -(l / o) grad o`` at one point."""
    inverse = -1.0 / length_scale
    o = gx = gy = gz = 0.0
    for j in range(nodes.shape[1]):
        a, b, c = x - nodes[0, j], y - nodes[1, j], z - nodes[2, j]
        r = np.sqrt(a * a + b * b + c * c + _TINY)
        k = alpha[j] * fast_exp(r * inverse)
        w = k / r
        o += k
        gx += w * a
        gy += w * b
        gz += w * c
    o = max(o, MIN_OCCUPANCY)
    return -length_scale * np.log(o), gx / o, gy / o, gz / o


@njit(cache=True)
def values(nodes: Array, alpha: Array, length_scale: float, points: Array) -> Array:
    """Raw distance at every point, shape ``(m,)``."""
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = value_at(nodes, alpha, length_scale, points[i, 0], points[i, 1], points[i, 2])
    return out


@njit(cache=True)
def values_and_gradients(
    nodes: Array, alpha: Array, length_scale: float, points: Array
) -> tuple[Array, Array]:
    """Raw distance ``(m,)`` and gradient ``(m, 3)`` at every point."""
    value = np.empty(len(points))
    gradient = np.empty((len(points), 3))
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        d, gx, gy, gz = value_and_gradient_at(nodes, alpha, length_scale, x, y, z)
        value[i] = d
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
    return value, gradient


@njit(cache=True, error_model="numpy")
def newton_step(d: float, slope: float) -> float:
    """Damped Newton step onto d = 0; |grad d| is 0.04 to 0.9, so a step of d is too short."""
    return min(max(d / max(slope, SLOPE_FLOOR), -2.5 * abs(d)), 2.5 * abs(d))


@njit(cache=True, error_model="numpy")
def refine(
    nodes: Array, alpha: Array, length_scale: float, points: Array, steps: int
) -> tuple[Array, Array, Array, Array]:
    """Marches every point onto the surface d = 0, against the unit gradient at each step.

    Returns:
        Signed path length (m,), end points (m, 3), unit normals there (m, 3), residual d (m,).
    """
    m = len(points)
    travelled = np.zeros(m)
    ends = np.empty((m, 3))
    normals = np.empty((m, 3))
    residual = np.empty(m)
    for i in range(m):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for step in range(steps + 1):
            d, gx, gy, gz = value_and_gradient_at(nodes, alpha, length_scale, x, y, z)
            slope = np.sqrt(gx * gx + gy * gy + gz * gz)
            unit = 1.0 / max(slope, 1e-12)
            gx, gy, gz = gx * unit, gy * unit, gz * unit
            if step == steps:
                break
            length = newton_step(d, slope)
            travelled[i] += length
            x, y, z = x - length * gx, y - length * gy, z - length * gz
        ends[i, 0], ends[i, 1], ends[i, 2] = x, y, z
        normals[i, 0], normals[i, 1], normals[i, 2] = gx, gy, gz
        residual[i] = d
    return travelled, ends, normals, residual


@njit(cache=True, error_model="numpy")
def first_hits(
    nodes: Array,
    alpha: Array,
    length_scale: float,
    poses: Array,
    body_points: Array,
    box: Array,
    margin: float,
) -> NDArray[np.int64]:
    """Which point of a posed body comes closer to the surface than ``margin``, -1 for none.

    The raw distance underestimates outside. So a raw value above the margin clears its point, and
    every other body point within the rest of that distance; a positive one below the margin is
    refined by two Newton steps. Points outside ``box`` (2, 3) are free.
    """
    k = len(body_points)
    apart = np.empty((k, k))
    for i in range(k):
        for j in range(k):
            u = body_points[i, 0] - body_points[j, 0]
            v = body_points[i, 1] - body_points[j, 1]
            w = body_points[i, 2] - body_points[j, 2]
            apart[i, j] = np.sqrt(u * u + v * v + w * w)
    out = np.full(len(poses), -1)
    cleared = np.empty(k, dtype=np.bool_)
    for i in range(len(poses)):
        X = poses[i]
        cleared[:] = False
        for j in range(k):
            if cleared[j]:
                continue
            u, v, w = body_points[j, 0], body_points[j, 1], body_points[j, 2]
            x = X[0, 0] * u + X[0, 1] * v + X[0, 2] * w + X[0, 3]
            y = X[1, 0] * u + X[1, 1] * v + X[1, 2] * w + X[1, 3]
            z = X[2, 0] * u + X[2, 1] * v + X[2, 2] * w + X[2, 3]
            if (
                x < box[0, 0]
                or x > box[1, 0]
                or y < box[0, 1]
                or y > box[1, 1]
                or z < box[0, 2]
                or z > box[1, 2]
            ):
                continue
            travelled = value_at(nodes, alpha, length_scale, x, y, z)
            for other in range(j + 1, k):
                cleared[other] |= apart[j, other] < travelled - margin
            if 0.0 <= travelled < margin:
                travelled = 0.0
                for _ in range(2):
                    d, gx, gy, gz = value_and_gradient_at(nodes, alpha, length_scale, x, y, z)
                    slope = np.sqrt(gx * gx + gy * gy + gz * gz)
                    length = newton_step(d, slope)
                    travelled += length
                    step = length / max(slope, 1e-12)
                    x, y, z = x - step * gx, y - step * gy, z - step * gz
            if travelled < margin:
                out[i] = j
                break
    return out


@njit(cache=True)
def march_to_exit(
    nodes: Array,
    alpha: Array,
    length_scale: float,
    starts: Array,
    directions: Array,
    start_length: float,
    max_length: float,
    min_step: float,
) -> Array:
    """Length along each ray at which it first leaves the inside (d < 0), from ``start_length`` on.

    Inside, |d| underestimates the way out, so steps of |d| (at least ``min_step``) are safe; the
    sign change is then bisected. NaN where the start is outside or ``max_length`` is reached.
    """
    out = np.full(len(starts), np.nan)
    for i in range(len(starts)):
        px, py, pz = starts[i, 0], starts[i, 1], starts[i, 2]
        ux, uy, uz = directions[i, 0], directions[i, 1], directions[i, 2]
        inside = start_length
        d = value_at(
            nodes, alpha, length_scale, px + inside * ux, py + inside * uy, pz + inside * uz
        )
        if d >= 0.0:
            continue
        while inside <= max_length:
            t = inside + max(min_step, -d)
            d = value_at(nodes, alpha, length_scale, px + t * ux, py + t * uy, pz + t * uz)
            if d >= 0.0:
                low, high = inside, t
                for _ in range(6):
                    middle = 0.5 * (low + high)
                    x, y, z = px + middle * ux, py + middle * uy, pz + middle * uz
                    if value_at(nodes, alpha, length_scale, x, y, z) < 0.0:
                        low = middle
                    else:
                        high = middle
                out[i] = 0.5 * (low + high)
                break
            inside = t
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def farthest_points(points: Array, count: int) -> NDArray[np.int64]:
    """Indices of ``count`` points, each the farthest from those before it.

    Starts with the point farthest from the centroid, so the choice moves with the cloud under
    rigid motions (ties apart) and needs no random numbers.
    """
    n = len(points)
    xs, ys, zs = points[:, 0].copy(), points[:, 1].copy(), points[:, 2].copy()
    nearest = np.full(n, np.inf)
    chosen = np.empty(count, dtype=np.int64)
    x, y, z = xs.mean(), ys.mean(), zs.mean()
    for i in range(count + 1):
        for j in range(n):
            a, b, c = xs[j] - x, ys[j] - y, zs[j] - z
            nearest[j] = min(nearest[j], a * a + b * b + c * c)
        if i == count:
            break
        best = np.argmax(nearest)
        chosen[i] = best
        x, y, z = xs[best], ys[best], zs[best]
        if i == 0:
            nearest[:] = np.inf
    return chosen
