"""The shortest joint velocity that moves a hand with a given twist, damped near singularities."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array

#: Least damping: no singular value is taken for smaller.
_LEAST_DAMPING = 1e-6
#: Least pivot of the factorisation, in case rounding eats up even that.
_LEAST_PIVOT = 1e-14


@njit(cache=True, error_model="numpy")
def least_norm_kernel(J: Array, V: Array, damping: float) -> Array:
    """``J^T (J J^T + d^2 I)^-1 V``, shape (7,), by Cholesky factorisation of the 6 x 6 matrix."""
    square = max(damping, _LEAST_DAMPING) ** 2
    L, y, qd = np.empty((6, 6)), np.empty(6), np.zeros(7)
    for i in range(6):
        for j in range(i + 1):
            s = square if i == j else 0.0
            for k in range(7):
                s += J[i, k] * J[j, k]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(s, _LEAST_PIVOT)) if i == j else s / L[j, j]
    for i in range(6):
        s = V[i]
        for k in range(i):
            s -= L[i, k] * y[k]
        y[i] = s / L[i, i]
    for i in range(5, -1, -1):
        s = y[i]
        for k in range(i + 1, 6):
            s -= L[k, i] * y[k]
        y[i] = s / L[i, i]
    for i in range(6):
        for k in range(7):
            qd[k] += J[i, k] * y[i]
    return qd


def least_norm_velocity(J: ArrayLike, V: ArrayLike, damping: float = 0.0) -> Array:
    """The pseudo-inverse solution ``J^+ V`` of ``J qd = V``, or a damped one.

    Args:
        J: Jacobian, shape (6, 7), rows [angular; linear].
        V: Twist [rad/s; m/s], shape (6,).
        damping: The velocity minimises ``|J qd - V|^2 + damping^2 |qd|^2``; it is at most
            ``|V| / (2 damping)``.

    Returns:
        Joint velocity [rad/s], shape (7,). Without damping it is large where J loses rank, but
        finite.
    """
    J, V = np.ascontiguousarray(J, dtype=float), np.ascontiguousarray(V, dtype=float)
    result: Array = least_norm_kernel(J, V, damping)
    return result
