"""Objects put together from several solids: boxes, mug, hammer, drill, duck."""

from __future__ import annotations

from math import hypot, sqrt

import numpy as np
from manifold3d import Manifold

from feasigrasp_lab.training.data.solids import (
    clean,
    lathe,
    loft,
    profile,
    rounded_box,
    tube,
)

_X, _Y, _Z = np.eye(3)


def box() -> Manifold:
    """A carton standing upright."""
    return rounded_box((0.090, 0.045, 0.170), 0.003, cell=0.014)


def small_box() -> Manifold:
    """A flat carton."""
    return rounded_box((0.080, 0.060, 0.035), 0.002, cell=0.010)


def l_block() -> Manifold:
    """Two blocks in an L."""
    foot = rounded_box((0.110, 0.040, 0.040), 0.003, cell=0.008).translate([0.055, 0.020, 0.020])
    post = rounded_box((0.040, 0.040, 0.090), 0.003, cell=0.008).translate([0.020, 0.020, 0.045])
    return clean(foot + post)


def mug() -> Manifold:
    """A cylinder mug with a wall of 4 mm and a bail for two fingers."""
    outside = [(0, 0), (0.038, 0, 0.004), (0.039, 0.092, 0.001), (0, 0.092)]
    inside = [(0, 0.006), (0.0335, 0.006, 0.004), (0.035, 0.094), (0, 0.094)]
    t = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 22)
    path = np.column_stack([0.036 + 0.033 * np.cos(t), 0 * t, 0.047 + 0.027 * np.sin(t)])
    handle = tube(path, np.array([0.004, 0.0065]), side=(0, -1, 0), segments=14)
    body = lathe(profile(outside), segments=48)
    return clean(body + handle - lathe(profile(inside), segments=48))


def hammer() -> Manifold:
    """A claw hammer lying down: handle along x, head along y."""
    x = np.array([0, 2, 6, 15, 35, 60, 90, 120, 150, 180, 205, 222, 228])
    a = np.array([8, 12, 14.5, 15.5, 14.5, 14, 15, 13, 11, 10, 9.5, 9.5, 9.5])
    b = np.array([6, 9, 11, 12, 11.5, 11, 11.5, 10, 8, 7.5, 7.5, 7.5, 7.5])
    centers = np.column_stack([x, 0 * x, 0 * x]) * 1e-3
    half = np.column_stack([a, b]) * 1e-3
    handle = loft(centers, half, _Y, _Z, power=2.4, segments=24)

    outline = [
        (0, -0.050),
        (0.0135, -0.050, 0.0015),
        (0.0135, -0.036, 0.002),
        (0.0095, -0.030, 0.003),
        (0.0100, -0.014, 0.003),
        (0.0125, -0.010, 0.002),
        (0.0125, 0.012, 0.003),
        (0.0090, 0.020),
        (0, 0.020),
    ]
    face = lathe(profile(outline, arc=3), segments=28).rotate([-90, 0, 0])
    t = np.linspace(0, 1, 16)
    path = np.column_stack([-0.030 * t**2, 0.010 + 0.055 * t, 0 * t])
    claw = tube(
        path, np.column_stack([0.0085 - 0.0065 * t, 0.0085 + 0.004 * t]), side=(0, 0, 1), power=3
    )
    slot = tube(
        path[5:] + [0, 0.001, 0],
        np.column_stack([0.02 + 0 * t[5:], 0.0002 + 0.004 * (t[5:] - t[5])]),
        side=(0, 0, 1),
        power=8,
    )
    head = face + (claw - slot)
    return clean(handle + head.translate([0.222, 0, 0]))


def drill() -> Manifold:
    """A cordless drill: motor housing along x, chuck, pistol grip, trigger, battery."""
    outline = [
        (0, -0.060),
        (0.018, -0.060, 0.006),
        (0.0235, -0.045, 0.006),
        (0.0240, 0.035, 0.004),
        (0.0190, 0.045, 0.003),
        (0.0175, 0.060, 0.002),
        (0.0180, 0.062),
        (0.0180, 0.078, 0.003),
        (0.0090, 0.094, 0.003),
        (0.0060, 0.096),
        (0.0030, 0.096),
        (0.0030, 0.118, 0.001),
        (0, 0.120),
    ]
    housing = lathe(profile(outline, arc=2), segments=28).rotate([0, 90, 0])
    z = np.array([-0.118, -0.108, -0.090, -0.070, -0.050, -0.030, -0.012, 0.0])
    x = np.array([-0.048, -0.046, -0.042, -0.037, -0.033, -0.029, -0.025, -0.023])
    a = np.array([22, 20, 18.5, 18, 18.5, 20, 24, 26]) * 1e-3
    b = np.array([18, 16.5, 16, 16.5, 16.5, 16, 16, 16]) * 1e-3
    grip = loft(
        np.column_stack([x, 0 * x, z]), np.column_stack([a, b]), _X, _Y, power=2.5, segments=24
    )
    battery = rounded_box((0.090, 0.056, 0.034), 0.006, cell=0.015).translate([-0.040, 0, -0.128])
    trigger = rounded_box((0.018, 0.012, 0.026), 0.004, arc=2).translate([-0.010, 0, -0.040])
    return clean(housing + grip + battery + trigger)


def duck() -> Manifold:
    """A bath duck: one smooth skin over body, tail, head, beak and wings."""

    def egg(x: float, y: float, z: float, cx: float, cz: float, half: tuple[float, ...]) -> float:
        u, v, w = (x - cx) / half[0], y / half[1], (z - cz) / half[2]
        k = sqrt(u * u + v * v + w * w)
        slope = hypot(u / half[0], v / half[1], w / half[2])
        return k * (k - 1) / slope if slope > 1e-9 else -min(half)

    def skin(x: float, y: float, z: float) -> float:
        body = egg(x, y, z, 0.0, 0.0, (0.0255, 0.0195, 0.0165))
        tail = egg(x + 0.35 * z, y, z, -0.0180, 0.0120, (0.0075, 0.0095, 0.0085))
        head = egg(x, y, z, 0.0120, 0.0235, (0.0140, 0.0135, 0.0135))
        beak = egg(x, y, z - 0.10 * (x - 0.02), 0.0245, 0.0205, (0.0095, 0.0075, 0.0032))
        wing = egg(x, abs(y) - 0.0165, z, -0.004, 0.003, (0.0140, 0.0045, 0.0080))
        whole = _smooth_min(_smooth_min(body, tail, 0.008), head, 0.007)
        whole = _smooth_min(_smooth_min(whole, beak, 0.002), wing, 0.002)
        return max(whole, -0.0135 - z)  # a flat bottom to sit on

    bounds = [-0.036, -0.026, -0.016, 0.040, 0.026, 0.042]
    body = Manifold.level_set(lambda x, y, z: -skin(x, y, z), bounds, 0.0038, 0.0, 1e-5)
    bounds = np.array(body.bounding_box())
    return clean(body.scale(list(np.array([0.058, 0.041, 0.054]) / (bounds[3:] - bounds[:3]))))


def _smooth_min(a: float, b: float, width: float) -> float:
    """Minimum of two distances that rounds the crease between them off over ``width``."""
    h = max(width - abs(a - b), 0.0) / width
    return min(a, b) - h * h * width / 4.0
