"""The families of household shapes that are several solids in one."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from feasigrasp.training.data import household_solids as parts
from feasigrasp.training.data.household_solids import Rng, log_uniform
from feasigrasp.training.data.solids import clean, lathe, loft, profile, rounded_box, tube

_PARTS = (parts.box, parts.cylinder, parts.capsule, parts.bottle, parts.ball, parts.bent)
_Y, _Z = np.eye(3)[1], np.eye(3)[2]


def compound(rng: Rng) -> Manifold:
    """Two to four parts that run into each other: lamps, toys, pumps, brackets, jugs."""
    body = _PARTS[rng.integers(len(_PARTS) - 1)](rng)
    for _ in range(rng.integers(1, 4)):
        part = _PARTS[rng.integers(len(_PARTS))](rng)
        part = part.rotate((90.0 * rng.integers(0, 4, 3)).tolist())
        if rng.random() < 0.3:
            part = part.rotate(rng.uniform(-60, 60, 3).tolist())
        at = _surface_point(body, rng) - 0.5 * _surface_point(part, rng)
        joined = body + part.translate(at.tolist())
        if len(joined.decompose()) == 1:
            body = joined
    size = np.array(body.bounding_box())
    largest = float((size[3:] - size[:3]).max())
    if largest > 0.22:
        body = body.scale([0.22 / largest] * 3)
    return clean(body)


def mug(rng: Rng) -> Manifold:
    """A hollow vessel with a handle on its side."""
    radius, height = log_uniform(rng, 0.025, 0.048), log_uniform(rng, 0.06, 0.13)
    top = radius * rng.uniform(0.9, 1.15)
    wall = rng.uniform(0.0025, 0.005)
    edge = rng.uniform(0.001, 0.008)
    outside = lathe(profile([(0, 0), (radius, 0, edge), (top, height), (0, height)], arc=3))
    bore = profile([(0, wall), (radius - wall, wall, edge), (top - wall, height + 1e-3)])
    inside = lathe(np.concatenate([bore, [[0, height + 1e-3]]]))
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 22)
    reach, span = rng.uniform(0.022, 0.040), height * rng.uniform(0.25, 0.36)
    path = np.column_stack([radius - 0.003 + reach * np.cos(t), 0 * t, span * np.sin(t)])
    path[:, 2] += height * rng.uniform(0.45, 0.55)
    half = np.array([rng.uniform(0.003, 0.005), rng.uniform(0.004, 0.009)])
    handle = tube(path, half, side=(0, -1, 0), power=rng.uniform(2.0, 3.5), segments=14)
    return clean(outside + handle - inside)


def tool(rng: Rng) -> Manifold:
    """A handle and a head: hammer, brush, screwdriver, spatula, ladle, wrench."""
    length = log_uniform(rng, 0.09, 0.20)
    x = np.linspace(0, length, 14)
    swell = 1.0 + 0.2 * np.sin(np.pi * rng.uniform(1, 4) * x / length + rng.uniform(0, 6))
    thick = log_uniform(rng, 0.005, 0.016) * swell
    thick[[0, -1]] *= 0.75
    half = np.column_stack([thick, thick * rng.uniform(0.5, 1.0)])
    centers = np.column_stack([x, 0 * x, 0 * x])
    handle = loft(centers, half, _Y, _Z, power=rng.uniform(2.0, 3.5), segments=20)
    return clean(handle + _head(rng, thick[-1]).translate([length, 0, 0]))


def _head(rng: Rng, thick: float) -> Manifold:
    """What a tool works with, round the end of its handle."""
    kind = rng.integers(4)
    if kind == 0:  # across the handle, like a hammer's
        size = [rng.uniform(0.018, 0.034), rng.uniform(0.06, 0.11), rng.uniform(0.018, 0.034)]
        return rounded_box(size, 0.003, arc=2, cell=0.02)
    if kind == 1:  # a blade along it
        size = [rng.uniform(0.05, 0.09), rng.uniform(0.02, 0.07), rng.uniform(0.003, 0.010)]
        plate = rounded_box(size, 0.3 * size[2], arc=1, cell=0.02)
        return plate.translate([0.45 * size[0], 0, 0])
    if kind == 2:  # a shaft, thinner than the handle
        radius, reach = max(0.0025, 0.4 * thick), rng.uniform(0.04, 0.09)
        return (
            Manifold.cylinder(reach, radius, radius, 20).rotate([0, 90, 0]).translate([-3e-3, 0, 0])
        )
    jaw = parts.ball(rng)  # a lump
    low = np.array(jaw.bounding_box())[0]
    return jaw.translate([0.8 * -low, 0, 0])


def _surface_point(body: Manifold, rng: Rng) -> np.ndarray:
    """One of the vertices of a solid, shape (3,)."""
    vertices = np.asarray(body.to_mesh64().vert_properties)[:, :3]
    return np.asarray(vertices[rng.integers(len(vertices))])
