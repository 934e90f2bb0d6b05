"""Evenly spread points on a sphere."""

import numpy as np

from feasigrasp.models.arrays import Array


def sphere_points(n: int, radius: float) -> Array:
    """The Fibonacci lattice: n points on a sphere round the origin, shape (n, 3)."""
    i = np.arange(n) + 0.5
    z = 1.0 - 2.0 * i / n
    azimuth = np.pi * (1.0 + np.sqrt(5.0)) * i
    rho = np.sqrt(1.0 - z * z)
    return radius * np.stack([rho * np.cos(azimuth), rho * np.sin(azimuth), z], axis=1)
