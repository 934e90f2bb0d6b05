"""Primitive solids: lofts, lathes, tubes, boxes, and their booleans.

Every function returns a closed `manifold3d.Manifold` in metres. Only the generators of objects need
this.
"""

from collections.abc import Sequence

import numpy as np
from manifold3d import Manifold, Mesh64

from feasigrasp.models.arrays import Array, Indices


def solid(vertices: Array, faces: Indices) -> Manifold:
    """A solid from a closed triangle mesh with outward faces."""
    body = Manifold(Mesh64(np.asarray(vertices, float), np.asarray(faces, np.uint64)))
    if body.is_empty() or body.volume() <= 0:
        raise ValueError(f"not a closed outward surface: {body.status()}")
    return body


def clean(body: Manifold) -> Manifold:
    """Drops the slivers (up to 0.02 mm) that a boolean leaves where surfaces meet."""
    return body.simplify(2e-5)


def loft(
    centers: Array, half: Array, u: Array, v: Array, *, power: Array | float = 2.0, segments: int
) -> Manifold:
    """Skins superellipses ``|x/a|^n + |y/b|^n = 1`` one above the other, with flat end caps.

    Args:
        centers: Centres of the k sections, shape (k, 3).
        half: Half axes a, b, shape (k, 2); (0, 0) at an end makes a pole.
        u: Direction of a, shape (k, 3) or (3,).
        v: Direction of b; ``u x v`` points along the loft.
        power: Exponent n, shape (k,) or one number: 2 is an ellipse, 4 nearly a rectangle.
        segments: Points per section.
    """
    k = len(centers)
    angle = 2 * np.pi * np.arange(segments) / segments
    c, s = np.cos(angle), np.sin(angle)
    exponent = 2.0 / np.broadcast_to(power, (k,))[:, None]
    x = half[:, :1] * np.sign(c) * np.abs(c) ** exponent
    y = half[:, 1:] * np.sign(s) * np.abs(s) ** exponent
    u, v = np.broadcast_to(u, (k, 3)), np.broadcast_to(v, (k, 3))
    rings = centers[:, None] + x[..., None] * u[:, None] + y[..., None] * v[:, None]
    keep = half.any(axis=1)
    rings, n = rings[keep], int(keep.sum())
    i, j = np.meshgrid(np.arange(n - 1), np.arange(segments), indexing="ij")
    a, b = i * segments + j, i * segments + (j + 1) % segments
    walls = np.stack([a, b, b + segments, a, b + segments, a + segments], -1).reshape(-1, 3)
    spoke, bottom, top = np.arange(segments), n * segments, n * segments + 1
    after, last = (spoke + 1) % segments, (n - 1) * segments
    below = np.stack([after, spoke, np.full_like(spoke, bottom)], -1)
    above = np.stack([last + spoke, last + after, np.full_like(spoke, top)], -1)
    vertices = np.concatenate([rings.reshape(-1, 3), centers[[0, -1]]])
    return solid(vertices, np.concatenate([walls, below, above]))


def profile(corners: Sequence[tuple[float, ...]], *, arc: int = 4, step: float = 0.012) -> Array:
    """A polyline ``(r, z)`` with rounded corners and no segment longer than ``step``.

    Args:
        corners: ``(r, z)`` or ``(r, z, fillet radius)``; the first and last one stay sharp.
        arc: Segments per rounded corner.
        step: Longest segment [m].
    """
    points = [np.array(corners[0][:2])]
    for before, here, after in zip(corners, corners[1:], corners[2:], strict=False):
        p = np.array(here[:2])
        d0, d1 = np.array(before[:2]) - p, np.array(after[:2]) - p
        l0, l1 = np.linalg.norm(d0), np.linalg.norm(d1)
        d0, d1 = d0 / l0, d1 / l1
        if len(here) < 3 or d0 @ d1 < -0.999:
            points.append(p)
            continue
        half = np.arccos(np.clip(d0 @ d1, -1, 1)) / 2
        reach = min(here[2] / np.tan(half), 0.499 * l0, 0.499 * l1)
        radius = reach * np.tan(half)
        middle = p + (d0 + d1) / np.linalg.norm(d0 + d1) * radius / np.sin(half)
        start, end = p + reach * d0 - middle, p + reach * d1 - middle
        turn = np.arctan2(start[0] * end[1] - start[1] * end[0], start @ end)
        for t in np.linspace(0, turn, arc + 1):
            rotation = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
            points.append(middle + rotation @ start)
    points.append(np.array(corners[-1][:2]))
    fine = [points[0]]
    for p, q in zip(points, points[1:], strict=False):
        pieces = max(1, int(np.ceil(np.linalg.norm(q - p) / step - 1e-9)))
        fine += [p + (q - p) * t for t in np.arange(1, pieces + 1) / pieces]
    return np.array(fine)


def lathe(outline: Array, *, segments: int = 40) -> Manifold:
    """Turns an outline ``(r, z)``, from the bottom up and on the axis at both ends, about z."""
    centers = np.column_stack([np.zeros((len(outline), 2)), outline[:, 1]])
    half = np.column_stack([outline[:, 0], outline[:, 0]])
    return loft(centers, half, np.eye(3)[0], np.eye(3)[1], segments=segments)


def tube(
    path: Array, half: Array, *, side: Sequence[float], power: float = 2.0, segments: int = 16
) -> Manifold:
    """Sweeps ellipses along a path in a plane; ``side`` is that plane's normal (direction of b)."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    v = np.asarray(side, float)
    u = np.cross(v, tangent)
    half = np.broadcast_to(half, (len(path), 2))
    return loft(path, half, u, v, power=power, segments=segments)


def rounded_box(
    size: Sequence[float], radius: float, *, arc: int = 3, cell: float = 0.012
) -> Manifold:
    """A box with rounded edges, centred at the origin; its flat faces have square cells."""
    core = np.asarray(size, float) / 2 - radius
    flat = [np.linspace(-1, 1, 1 + max(1, round(2 * c / cell))) for c in core]
    ramp = np.arange(1, arc + 1) / arc
    axes = [np.concatenate([-1 - ramp[::-1], f, 1 + ramp]) for f in flat]  # 1..2 is the rounding
    vertices, faces, offset = [], [], 0
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        g, h = np.meshgrid(axes[i], axes[j], indexing="ij")
        cells = np.arange(g.size).reshape(g.shape)
        a, b = cells[:-1, :-1].ravel(), cells[1:, :-1].ravel()
        c, d = cells[1:, 1:].ravel(), cells[:-1, 1:].ravel()
        for sign in (-1.0, 1.0):
            point = np.empty((*g.shape, 3))
            point[..., i], point[..., j], point[..., axis] = g, h, 2 * sign
            vertices.append(point.reshape(-1, 3))
            quads = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
            faces.append((quads if sign > 0 else quads[:, ::-1]) + offset)
            offset += g.size
    grid, index = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
    inner = np.clip(grid, -1, 1)
    direction = np.tan((grid - inner) * np.pi / 4)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return solid(inner * core + radius * direction, index.reshape(-1)[np.concatenate(faces)])


def ellipsoid(half: Sequence[float], *, rings: int = 14, segments: int = 24) -> Manifold:
    """An ellipsoid with these half axes, centred at the origin."""
    t = np.linspace(-np.pi / 2, np.pi / 2, rings + 1)[1:-1]
    arc = np.concatenate([[[0, -1]], np.column_stack([np.cos(t), np.sin(t)]), [[0, 1]]])
    return lathe(arc, segments=segments).scale(list(half))
