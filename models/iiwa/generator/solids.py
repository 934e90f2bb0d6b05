"""Solid shapes as signed distance functions, and their surfaces as triangle meshes.

A solid is a function from points ``(n, 3)`` to signed distances ``(n,)``, negative inside.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array, Indices

Floats = Array
Solid = Callable[[Floats], Floats]


class Mesh(NamedTuple):
    """Triangles with one normal per vertex."""

    points: Floats
    normals: Floats
    triangles: Indices


def cylinder(a: ArrayLike, b: ArrayLike, radius: float, rounding: float = 0.004) -> Solid:
    """Cylinder from a to b whose edges are rounded."""
    start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    axis = (end - start) / np.linalg.norm(end - start)
    middle, half = (start + end) / 2, np.linalg.norm(end - start) / 2

    def distance(p: Floats) -> Floats:
        along = (p - middle) @ axis
        across = np.linalg.norm(p - middle - along[:, None] * axis, axis=1)
        d = np.stack([across - radius + rounding, np.abs(along) - half + rounding], axis=1)
        return np.minimum(d.max(axis=1), 0) + np.linalg.norm(np.maximum(d, 0), axis=1) - rounding

    return distance


def cone(a: ArrayLike, b: ArrayLike, radius_a: float, radius_b: float) -> Solid:
    """Capsule whose radius changes linearly from a to b (a bound of the distance)."""
    start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    step = end - start

    def distance(p: Floats) -> Floats:
        t = np.clip((p - start) @ step / (step @ step), 0, 1)
        radius = radius_a + (radius_b - radius_a) * t
        return np.linalg.norm(p - start - t[:, None] * step, axis=1) - radius

    return distance


def rounded_box(center: ArrayLike, size: ArrayLike, rounding: float) -> Solid:
    """Axis-aligned box with rounded edges."""
    middle, half = np.asarray(center, dtype=float), np.asarray(size, dtype=float) / 2 - rounding

    def distance(p: Floats) -> Floats:
        d = np.abs(p - middle) - half
        return np.minimum(d.max(axis=1), 0) + np.linalg.norm(np.maximum(d, 0), axis=1) - rounding

    return distance


def union(first: Solid, second: Solid, blend: float) -> Solid:
    """Union whose inner edge is filled over a length of about ``blend``."""

    def distance(p: Floats) -> Floats:
        a, b = first(p), second(p)
        h = np.maximum(blend - np.abs(a - b), 0) / blend
        return np.minimum(a, b) - h * h * blend / 4

    return distance


def difference(first: Solid, second: Solid, blend: float = 0.006) -> Solid:
    """The first solid without the second, with a rounded rim."""
    inverse = union(lambda p: -first(p), second, blend)
    return lambda p: -inverse(p)


def gradient(solid: Solid, points: Floats, step: float = 5e-4) -> Floats:
    """Central differences of the distance."""
    columns = [(solid(points + e) - solid(points - e)) / (2 * step) for e in step * np.eye(3)]
    return np.stack(columns, axis=1)


def surface(solid: Solid, low: ArrayLike, high: ArrayLike, cell: float) -> Mesh:
    """Surface of a solid inside a box by surface nets (Gibson 1998).

    Every grid cell that the surface crosses gets one vertex, moved onto the surface by Newton
    steps; every crossed grid edge gets the quad of the four cells around it.
    """
    axes = [
        np.arange(a - 1.37 * cell, b + 2.0 * cell, cell) for a, b in zip(low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    inside = solid(grid.reshape(-1, 3)).reshape(grid.shape[:3]) < 0
    corners = np.zeros(np.array(inside.shape) - 1, dtype=int)
    for i, j, k in np.ndindex(2, 2, 2):
        n = corners.shape
        corners += inside[i : i + n[0], j : j + n[1], k : k + n[2]]
    cells = np.argwhere((corners > 0) & (corners < 8))
    number = np.full(corners.shape, -1)
    number[tuple(cells.T)] = np.arange(len(cells))
    points = np.stack([axes[d][cells[:, d]] + cell / 2 for d in range(3)], axis=1)
    for _ in range(8):
        slope = gradient(solid, points)
        points = points - slope * (solid(points) / (slope**2).sum(axis=1).clip(0.1))[:, None]
    quads = []
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        u, v = np.roll(step, 1), np.roll(step, 2)
        near = inside[tuple(slice(None, -1) if s else slice(None) for s in step)]
        far = inside[tuple(slice(1, None) if s else slice(None) for s in step)]
        edge = np.argwhere(near != far)
        around = [number[tuple((edge + o).T)] for o in (0 * u, -u, -u - v, -v)]
        quad = np.stack(around, axis=1)
        leaves = near[tuple(edge.T)]  # the edge leads out of the solid
        quads.append(np.where(leaves[:, None], quad, quad[:, ::-1]))
    quad = np.concatenate(quads)
    if quad.min() < 0:
        raise ValueError(f"the solid leaves the box from {low} to {high}; make the box larger")
    triangles = np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]])
    slope = gradient(solid, points, 2e-3)
    return Mesh(points, slope / np.linalg.norm(slope, axis=1, keepdims=True), triangles)


def lathe(profile: ArrayLike, axis: str, origin: ArrayLike = (0, 0, 0), sides: int = 40) -> Mesh:
    """Surface of revolution about the z-axis (``z``) or the +-y-axis (``y``, ``-y``) at ``origin``.

    Args:
        profile: Points (radius, height), counter-clockwise seen with the radius to the right, so
            that the outside is to the right of the walk; edges stay sharp.
        axis: Direction of the height.
        origin: Where the heights start.
        sides: Segments of the circle.
    """
    profile = np.asarray(profile, dtype=float)
    turn = np.arange(sides) * (2 * np.pi / sides)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points, normals, triangles = [], [], []
    ring = np.arange(sides)
    after = (ring + 1) % sides
    for k, (start, end) in enumerate(zip(profile[:-1], profile[1:], strict=True)):
        out = np.array([end[1] - start[1], start[0] - end[0]]) / np.linalg.norm(end - start)
        for r, h in (start, end):
            points.append(np.column_stack([circle * r, np.full(sides, h)]))
            normals.append(np.column_stack([circle * out[0], np.full(sides, out[1])]))
        low = 2 * k * sides
        high = low + sides
        triangles.append(np.stack([low + ring, low + after, high + after], axis=1))
        triangles.append(np.stack([low + ring, high + after, high + ring], axis=1))
    rotation = {
        "z": np.eye(3),
        "y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        "-y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
    }[axis]
    return Mesh(
        np.concatenate(points) @ rotation.T + np.asarray(origin, dtype=float),
        np.concatenate(normals) @ rotation.T,
        np.concatenate(triangles),
    )


def bevelled_box(center: ArrayLike, size: ArrayLike, bevel: float) -> Mesh:
    """Box with bevelled edges, shaded as if they were round (24 points, one normal each)."""
    signs = np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1.0
    half = np.asarray(size, dtype=float) / 2
    # Point (corner c, axis d) lies on the face of axis d beside corner c.
    points = np.stack([signs * (half - bevel + bevel * np.eye(3)[d]) for d in range(3)], axis=1)
    normals = signs[:, None, :] * np.eye(3)
    quads = []
    for d in range(3):
        u, v = (d + 1) % 3, (d + 2) % 3
        along, bit_u, bit_v = 4 >> d, 4 >> u, 4 >> v  # bits of the axes in a corner's number
        for c in range(0, 8):
            if not c & along:  # the bevel of the edge from corner c along axis d
                end = c | along
                quads.append((3 * c + u, 3 * end + u, 3 * end + v, 3 * c + v))
            if not c & (bit_u | bit_v):  # the face of axis d
                quads.append(tuple(3 * k + d for k in (c, c | bit_u, c | bit_u | bit_v, c | bit_v)))
    triangles = np.array(
        [(3 * c, 3 * c + 1, 3 * c + 2) for c in range(8)]
        + [(q[0], q[i], q[i + 1]) for q in quads for i in (1, 2)]
    )
    points, normals = points.reshape(-1, 3), normals.reshape(-1, 3)
    corner = points[triangles]
    out = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    inward = (out * corner.sum(axis=1)).sum(axis=1) < 0
    triangles[inward] = triangles[inward][:, ::-1]
    return Mesh(points + np.asarray(center, dtype=float), normals, triangles)


def join(meshes: list[Mesh]) -> Mesh:
    """One mesh of several."""
    starts = np.cumsum([0, *(len(m.points) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.points for m in meshes]),
        np.concatenate([m.normals for m in meshes]),
        np.concatenate([m.triangles + s for m, s in zip(meshes, starts, strict=True)]),
    )
