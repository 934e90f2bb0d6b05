"""Information matrix of a registered pose, without the share that is noise.

The rows of a registration are ``J = -[r x n, n]``: point r from the origin of O, normal n. Along a
direction that the shape does not determine, such as the turn of a can, an ideal surface has
``J e = 0``; one that is known from noisy points has bumps, and a registration would take them for
information and follow them. Normals that err by the angle ``a`` give about ``a^2`` of the
information that normals in all directions would give. So that share is taken off every eigenvalue,
and what falls below zero is cut: there the estimate stays at its prior. Of an eigenvalue ``h`` of
which ``b`` is left, a gradient says that the error is ``g / b``, with the variance ``h / b^2``: the
information is ``b^2 / h``. (On regressors that err: Fuller, Measurement Error Models, 1987.)
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry import se3

#: Share of the whole information that wrong normals alone bring, in every direction, at least.
NOISE_SHARE = 0.003


def jacobian(lever: Array, normals: Array) -> Array:
    """Change of the distances of fixed points from a body by its error [theta, p].

    Args:
        lever: Points from the origin of O, in the axes of the world, shape (n, 3) [m].
        normals: Gradients of the distance there, in the same axes, shape (n, 3).

    Returns:
        Shape (n, 6).
    """
    (x, y, z), (a, b, c) = lever.T, normals.T
    # -(lever x normal), written out: np.cross is slower than all the rest.
    return np.stack([z * b - y * c, x * c - z * a, y * a - x * b, -a, -b, -c], axis=1)


def without_noise(
    J: Array, weights: Array, lever: Array, noise: float = NOISE_SHARE
) -> tuple[Array, Array]:
    """The information of weighted rows, less what noise alone would bring.

    Args:
        J: Rows, see `jacobian`, shape (n, 6).
        weights: Inverse variances, shape (n,).
        lever: Where they are, shape (n, 3) [m].
        noise: The share of noise, see `TrackedModel.noise_share`.

    Returns:
        The information (6, 6), and the projection (6, 6) that takes a gradient ``J^T w r`` to that
        part of it which is retained.
    """
    total = float(weights.sum())
    if total <= 0.0:
        return np.zeros((6, 6)), np.zeros((6, 6))
    middle = weights @ lever / total
    radius = float(np.sqrt(weights @ np.square(lever - middle).sum(axis=1) / total))
    # About the center of the visible points, in units that a turn moves points as far as a shift
    # does: theta and p there, e = T y.
    T = np.eye(6)
    T[:3, :3] /= max(radius, 1e-3)
    T[3:, :3] = se3.hat(middle) @ T[:3, :3]
    rows = J @ T
    values, vectors = np.linalg.eigh(rows.T @ (weights[:, None] * rows))
    retained = np.maximum(values - noise * total, 0.0)
    share = np.divide(retained, values, out=np.zeros(6), where=values > 0.0)
    T_inverse = np.linalg.inv(T)
    information = T_inverse.T @ (vectors * (retained * share)) @ vectors.T @ T_inverse
    projection = T_inverse.T @ (vectors * share) @ vectors.T @ T.T
    return information, projection


def surface_deviation(covariance: Array, lever: Array, normals: Array) -> float:
    """Root mean square distance between measured and expected surface, along the normals [m].

    What the shape does not determine does not count: a can may turn, and is where it was.

    Args:
        covariance: Of [theta, p], shape (6, 6).
        lever: Points of the surface from the origin of O, in the axes of the world, (n, 3) [m].
        normals: Their normals, shape (n, 3).
    """
    rows = jacobian(lever, normals)
    return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", rows, covariance, rows))))
