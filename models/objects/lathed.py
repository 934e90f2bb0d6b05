"""Objects that are one loft or lathe: cans, bottles, hollow ware, fruit, a screwdriver."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold

from feasigrasp_lab.training.data.solids import clean, ellipsoid, lathe, loft, profile, tube


def soup_can() -> Manifold:
    """A food can: rims at both ends, lids set in."""
    corners = [
        (0, 0.002),
        (0.030, 0.002),
        (0.0305, 0),
        (0.0335, 0, 0.001),
        (0.0335, 0.003),
        (0.0325, 0.004),
        (0.0325, 0.096),
        (0.0335, 0.097),
        (0.0335, 0.100, 0.001),
        (0.0305, 0.100),
        (0.030, 0.098),
        (0, 0.098),
    ]
    return lathe(profile(corners, arc=3), segments=40)


def spray_can() -> Manifold:
    """A spray can: domed shoulder and a spray head."""
    corners = [
        (0, 0.002),
        (0.022, 0.002),
        (0.024, 0),
        (0.0265, 0, 0.001),
        (0.0265, 0.135, 0.012),
        (0.0150, 0.147, 0.006),
        (0.0150, 0.150),
        (0.0125, 0.150),
        (0.0125, 0.170, 0.003),
        (0, 0.170),
    ]
    nozzle = ellipsoid((0.004, 0.003, 0.003), rings=8, segments=12).translate([0.0125, 0, 0.162])
    return clean(lathe(profile(corners), segments=40) + nozzle)


def water_bottle() -> Manifold:
    """A half-litre bottle: ribbed waist, shoulder, neck, screw cap."""
    corners = [(0, 0.004), (0.018, 0.004), (0.022, 0, 0.003), (0.032, 0, 0.006)]
    for z in (0.056, 0.074):
        corners += [(0.032, z, 0.002), (0.0293, z + 0.005, 0.004), (0.032, z + 0.010, 0.002)]
    corners += [
        (0.032, 0.140, 0.030),
        (0.0125, 0.175, 0.012),
        (0.0125, 0.186),
        (0.0155, 0.186, 0.001),
        (0.0155, 0.190, 0.001),
        (0.0140, 0.190),
        (0.0140, 0.206, 0.002),
        (0, 0.206),
    ]
    return lathe(profile(corners, arc=2, step=0.016), segments=28)


def mustard_bottle() -> Manifold:
    """A squeeze bottle: oval, narrower waist, round shoulders, pointed nozzle."""
    z = np.array([0, 1, 3, 8, 20, 40, 60, 80, 100, 115, 125, 132, 137, 140, 142, 142.5, 143])
    a = np.array([38, 41, 43, 44, 44, 43, 42, 42, 42.5, 41, 37, 31, 25, 20, 16, 15, 15])
    b = np.array([22, 24.5, 26, 27, 27.5, 27, 26.5, 26.5, 27, 26, 23, 20, 18, 16, 15.5, 15, 15])
    n = np.array([2.6] * 9 + [2.5, 2.4, 2.3, 2.2, 2.1, 2, 2, 2])
    z = np.append(z, [143.5, 160, 162, 162.5, 166, 172, 178, 183, 184])
    a = np.append(a, [16, 16, 15, 7, 6.5, 5, 4, 3, 2])
    b = np.append(b, [16, 16, 15, 7, 6.5, 5, 4, 3, 2])
    n = np.append(n, [2.0] * 9)
    centers = np.column_stack([0 * z, 0 * z, z]) * 1e-3
    half = np.column_stack([a, b]) * 1e-3
    return loft(centers, half, np.eye(3)[0], np.eye(3)[1], power=n, segments=40)


def bowl() -> Manifold:
    """A bowl on a foot ring, its wall 4 mm thick."""
    corners = [
        (0, 0.002),
        (0.024, 0.002),
        (0.026, 0),
        (0.032, 0, 0.002),
        (0.033, 0.004, 0.002),
        (0.058, 0.022, 0.040),
        (0.070, 0.055, 0.001),
        (0.066, 0.055, 0.001),
        (0.0542, 0.0245, 0.036),
        (0.030, 0.0065, 0.010),
        (0, 0.0065),
    ]
    return lathe(profile(corners, arc=3, step=0.010), segments=40)


def cup() -> Manifold:
    """A tapered drinking cup with a rolled rim, its wall 3 mm thick."""
    corners = [
        (0, 0.002),
        (0.024, 0.002),
        (0.025, 0),
        (0.028, 0, 0.002),
        (0.0365, 0.094),
        (0.0385, 0.095, 0.001),
        (0.0385, 0.100, 0.002),
        (0.0340, 0.100, 0.001),
        (0.0253, 0.005, 0.004),
        (0, 0.005),
    ]
    return lathe(profile(corners, arc=2, step=0.013), segments=36)


def ball() -> Manifold:
    """A plain ball."""
    return ellipsoid((0.033, 0.033, 0.033), rings=24, segments=36)


def apple() -> Manifold:
    """An apple: dimples at both ends, widest above the middle, a stem."""
    t = np.linspace(-np.pi / 2, np.pi / 2, 27)
    radius = 36e-3 * np.cos(t) ** 0.8 * (1 + 0.06 * np.sin(t))
    dimple = np.exp(-((radius / 0.012) ** 2))
    height = 32e-3 * np.sin(t) - np.sign(np.sin(t)) * dimple * np.where(t > 0, 0.009, 0.004)
    outline = np.column_stack([np.where(np.abs(np.cos(t)) < 1e-9, 0, radius), height])
    return clean(lathe(outline, segments=36) + _stem(z=0.018, length=0.022))


def pear() -> Manifold:
    """A pear: round belly, narrow top, a stem."""
    z = np.array([0, 1, 4, 10, 18, 28, 38, 48, 58, 68, 76, 83, 88, 91, 92]) * 1e-3
    r = np.array([0, 10, 20, 28, 32, 32.5, 31, 27, 22, 18.5, 17, 15.5, 12, 6, 0]) * 1e-3
    smooth = np.interp(np.linspace(0, 14, 30), np.arange(15), r)
    smooth[1:-1] = (smooth[:-2] + smooth[1:-1] + smooth[2:]) / 3
    height = np.interp(np.linspace(0, 14, 30), np.arange(15), z)
    return clean(lathe(np.column_stack([smooth, height]), segments=32) + _stem(0.086, 0.022))


def banana() -> Manifold:
    """A banana: a bent, tapered tube with stalk and tip."""
    s = np.linspace(0, 1, 37)
    bend = 0.95 * (2 * s - 1)
    path = np.column_stack([0.095 * np.sin(bend), 0 * s, 0.095 * (1 - np.cos(bend))])
    girth = np.interp(
        s,
        [0, 0.02, 0.06, 0.12, 0.25, 0.5, 0.72, 0.84, 0.89, 0.93, 1],
        [2.5, 4.5, 8, 12, 16.5, 17.5, 15.5, 10, 6, 4.5, 4.5],
    )
    half = np.column_stack([girth, girth]) * 1e-3
    return tube(path, half, side=(0, -1, 0), power=2.3, segments=24)


def screwdriver() -> Manifold:
    """A screwdriver lying along x: fluted handle, ferrule, shaft, flat blade."""
    x = np.array([0, 1, 3, 7, 15, 30, 50, 66, 74, 78, 82, 88, 94, 95, 100, 101])
    r = np.array([5, 9, 12, 14.5, 15.5, 15, 15.5, 15, 12, 10.5, 10.5, 12, 11, 7, 7, 3.5])
    x = np.append(x, [103, 115, 130, 145, 160, 175, 190, 196, 203, 208, 210])
    a = np.append(r, [3.5, 3.5, 3.5, 3.5, 3.5, 3.5, 3.5, 4, 4.5, 4.2, 4])
    b = np.append(r, [3.5, 3.5, 3.5, 3.5, 3.5, 3.5, 3.5, 2.5, 1.4, 0.8, 0.6])
    n = np.append([2.0, 2.2, 2.6, 3, 3, 3, 3, 3, 2.8, 2.4, 2.2, 2.2, 2], [2.0] * 14)
    fine = np.unique(np.concatenate([x, np.arange(6, 76, 6), np.arange(109, 190, 8)]))
    half = np.column_stack([np.interp(fine, x, a), np.interp(fine, x, b)]) * 1e-3
    centers = np.column_stack([fine, 0 * fine, 0 * fine]) * 1e-3
    y, z = np.eye(3)[1], np.eye(3)[2]
    return loft(centers, half, y, z, power=np.interp(fine, x, n), segments=24)


def _stem(z: float, length: float) -> Manifold:
    t = np.linspace(0, 1, 12)
    path = np.column_stack([0.005 * t**2, 0 * t, z + length * t])
    girth = 0.0016 + 0.0008 * t**2
    girth[[0, -1]] *= 0.6
    return tube(path, np.column_stack([girth, girth]), side=(0, -1, 0), segments=10)
