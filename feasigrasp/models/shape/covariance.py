"""Covariance matrices of the Gaussian process distance field."""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.simd import exp2_of_minus, rough_inverse_sqrt, wide_vectors
from feasigrasp.models.shape.node_sums import LOG2_E, TINY, pulled_in


@compiled(forceinline=True, fastmath=True)
def _fill_row(
    row: Array, xs: Array, ys: Array, zs: Array, x: float, y: float, z: float, scale: float
) -> None:
    """``e^-r/l`` from one point to many; in two passes, so that both keep the processor busy."""
    wide_vectors()
    for i in range(len(row)):
        a, b, c = xs[i] * scale - x, ys[i] * scale - y, zs[i] * scale - z
        square = a * a + b * b + c * c + TINY
        rough = rough_inverse_sqrt(square)
        distance = square * rough
        row[i] = distance * (1.5 - 0.5 * (distance * rough))
    for i in range(len(row)):
        row[i] = exp2_of_minus(row[i])


@compiled(nogil=True)
def gram_lower(nodes: Array, length_scale: float, noise_variance: Array) -> Array:
    """Lower triangle of ``K + diag(s2)`` at centred nodes (3, n), transposed, shape ``(n, n)``.

    Filled row by row; its ``.T`` is the lower triangle in the Fortran order that LAPACK wants. What
    is in the other triangle is undefined.
    """
    wide_vectors()
    n = nodes.shape[1]
    transposed = np.empty((n, n))
    scale = LOG2_E / length_scale
    for j in range(n):
        x, y, z = nodes[0, j] * scale, nodes[1, j] * scale, nodes[2, j] * scale
        _fill_row(transposed[j, j:], nodes[0, j:], nodes[1, j:], nodes[2, j:], x, y, z, scale)
        transposed[j, j] = 1.0 + noise_variance[j]
    return transposed


@compiled(nogil=True)
def cross_covariance(nodes: Array, length_scale: float, center: Array, points: Array) -> Array:
    """``k(x_i, X_j)`` between points (m, 3) and centred nodes (3, n), shape ``(m, n)``."""
    wide_vectors()
    out = np.empty((len(points), nodes.shape[1]))
    scale = LOG2_E / length_scale
    for i in range(len(points)):
        x, y, z = pulled_in(
            (points[i, 0] - center[0]) * scale,
            (points[i, 1] - center[1]) * scale,
            (points[i, 2] - center[2]) * scale,
        )
        _fill_row(out[i], nodes[0], nodes[1], nodes[2], x, y, z, scale)
    return out
