"""Compiled loops of the distance field over query points, rays and bodies.

The sums over the nodes are in `node_sums`, whose tiles and workspace they pass on. Points are
relative to the field's centre where a function takes no ``center``. All of them release Python's
lock, so that a thread can run them beside a simulation.
"""

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import wide_vectors
from feasigrasp.models.shape.node_sums import make_workspace, value_and_gradient_at, value_at


@compiled(nogil=True)
def values(tiles: Array, length_scale: float, center: Array, points: Array) -> Array:
    """Raw distance at every point, shape ``(m,)``."""
    wide_vectors()
    out = np.empty(len(points))
    work = make_workspace()
    u, v, w = center
    for i in range(len(points)):
        x, y, z = points[i, 0] - u, points[i, 1] - v, points[i, 2] - w
        out[i] = value_at(tiles, work, length_scale, x, y, z)
    return out


@compiled(nogil=True)
def values_and_gradients(
    tiles: Array, length_scale: float, center: Array, points: Array
) -> tuple[Array, Array]:
    """Raw distance ``(m,)`` and gradient ``(m, 3)`` at every point."""
    wide_vectors()
    value = np.empty(len(points))
    gradient = np.empty((len(points), 3))
    work = make_workspace()
    u, v, w = center
    for i in range(len(points)):
        x, y, z = points[i, 0] - u, points[i, 1] - v, points[i, 2] - w
        d, gx, gy, gz = value_and_gradient_at(tiles, work, length_scale, x, y, z)
        value[i] = d
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = gx, gy, gz
    return value, gradient


@compiled
def newton_step(d: float, slope: float) -> float:
    """Damped Newton step onto d = 0; |grad d| is 0.04 to 0.9, so a step of d is too short."""
    # Floor on |grad d| in the damped Newton step.
    return min(max(d / max(slope, 0.2), -2.5 * abs(d)), 2.5 * abs(d))


@compiled(nogil=True)
def refine(
    tiles: Array, length_scale: float, center: Array, points: Array, steps: int, damped: bool
) -> tuple[Array, Array, Array, Array]:
    """Marches every point onto the surface d = 0, against the unit gradient at each step.

    The steps are `newton_step`, or d itself if not ``damped``.

    Returns:
        Signed path length (m,), end points (m, 3), unit normals there (m, 3), residual d (m,).
    """
    wide_vectors()
    m = len(points)
    travelled = np.zeros(m)
    ends = np.empty((m, 3))
    normals = np.empty((m, 3))
    residual = np.empty(m)
    work = make_workspace()
    u, v, w = center
    for i in range(m):
        x, y, z = points[i, 0] - u, points[i, 1] - v, points[i, 2] - w
        for step in range(steps + 1):
            d, gx, gy, gz = value_and_gradient_at(tiles, work, length_scale, x, y, z)
            slope = np.sqrt(gx * gx + gy * gy + gz * gz)
            unit = 1.0 / max(slope, 1e-12)
            gx, gy, gz = gx * unit, gy * unit, gz * unit
            # Damped Newton steps end this close to the surface [m]; most do before their number is
            # up.
            if step == steps or (damped and abs(d) < 1e-9):
                break
            length = newton_step(d, slope) if damped else d
            travelled[i] += length
            x, y, z = x - length * gx, y - length * gy, z - length * gz
        ends[i, 0], ends[i, 1], ends[i, 2] = x + u, y + v, z + w
        normals[i, 0], normals[i, 1], normals[i, 2] = gx, gy, gz
        residual[i] = d
    return travelled, ends, normals, residual


@compiled(nogil=True)
def closest_points(
    tiles: Array,
    length_scale: float,
    poses: Array,
    body_points: Array,
    box: Array,
    far: float,
    near: float,
) -> tuple[Array, Indices]:
    """Distance of each posed body to the surface, at most ``far``, with its closest point.

    The raw distance underestimates outside. So a raw value clears its point, and every other body
    point within the rest of that distance, if it exceeds the least distance found; lower
    positive ones are refined by two Newton steps. Once a point is closer than ``near`` the others
    are not looked at. Points outside ``box`` (2, 3) are far.

    Returns:
        Distances (m,), and indices of body points (m,), -1 where all are far.
    """
    wide_vectors()
    work = make_workspace()
    k = len(body_points)
    apart = np.empty((k, k))
    for i in range(k):
        for j in range(k):
            u = body_points[i, 0] - body_points[j, 0]
            v = body_points[i, 1] - body_points[j, 1]
            w = body_points[i, 2] - body_points[j, 2]
            apart[i, j] = np.sqrt(u * u + v * v + w * w)
    distance = np.full(len(poses), far)
    index = np.full(len(poses), -1)
    least = np.empty(k)  # a lower bound for every body point
    for i in range(len(poses)):
        X = poses[i]
        least[:] = -np.inf
        for j in range(k):
            if least[j] >= distance[i]:
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
            travelled = value_at(tiles, work, length_scale, x, y, z)
            for other in range(j + 1, k):
                least[other] = max(least[other], travelled - apart[j, other])
            if 0.0 <= travelled < distance[i]:
                travelled = 0.0
                for _ in range(2):
                    d, gx, gy, gz = value_and_gradient_at(tiles, work, length_scale, x, y, z)
                    slope = np.sqrt(gx * gx + gy * gy + gz * gz)
                    length = newton_step(d, slope)
                    travelled += length
                    step = length / max(slope, 1e-12)
                    x, y, z = x - step * gx, y - step * gy, z - step * gz
            if travelled < distance[i]:
                distance[i], index[i] = travelled, j
                if travelled < near:
                    break
    return distance, index


@compiled(nogil=True)
def march_to_exit(
    tiles: Array,
    length_scale: float,
    starts: Array,
    directions: Array,
    start_length: float,
    max_length: float,
    min_step: float,
) -> Array:
    """Length along each ray at which it first leaves the inside (d < 0), from ``start_length`` on.

    Inside, |d| underestimates the way out, so steps of |d| (at least ``min_step``) are safe; the
    sign change is then found by false position, since d is nearly linear over one step. NaN where
    the start is outside or ``max_length`` is reached.
    """
    wide_vectors()
    out = np.full(len(starts), np.nan)
    work = make_workspace()
    for i in range(len(starts)):
        px, py, pz = starts[i, 0], starts[i, 1], starts[i, 2]
        ux, uy, uz = directions[i, 0], directions[i, 1], directions[i, 2]
        inside = start_length
        d = value_at(
            tiles, work, length_scale, px + inside * ux, py + inside * uy, pz + inside * uz
        )
        if d >= 0.0:
            continue
        while inside <= max_length:
            t = inside + max(min_step, -d)
            before = d
            d = value_at(tiles, work, length_scale, px + t * ux, py + t * uy, pz + t * uz)
            if d >= 0.0:
                low, high = inside, t
                for _ in range(2):
                    middle = low + (high - low) * before / (before - d)
                    x, y, z = px + middle * ux, py + middle * uy, pz + middle * uz
                    value = value_at(tiles, work, length_scale, x, y, z)
                    if value < 0.0:
                        low, before = middle, value
                    else:
                        high, d = middle, value
                out[i] = low + (high - low) * before / (before - d)
                break
            inside = t
    return out
