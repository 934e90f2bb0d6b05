"""Cholesky factorization of small matrices, without a call of LAPACK."""

import math

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled


@compiled
def cholesky_kernel(A: Array, L: Array, least_pivot: float) -> None:
    """Writes the lower factor of A (n, n), of which only the lower triangle is read.

    L may be A itself; its upper triangle is left as it is. Pivots below ``least_pivot`` are raised
    to it.
    """
    for i in range(len(A)):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(max(s, least_pivot)) if i == j else s / L[j, j]


@compiled
def cholesky_solve_kernel(L: Array, b: Array) -> None:
    """Replaces b (n,) by ``(L L^T)^-1 b``."""
    n = len(b)
    for i in range(n):
        for k in range(i):
            b[i] -= L[i, k] * b[k]
        b[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= L[k, i] * b[k]
        b[i] /= L[i, i]
