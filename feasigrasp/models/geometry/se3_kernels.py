"""Exponential and logarithm of SE(3) for single elements, for compiled code.

The conventions are those of :mod:`feasigrasp.models.geometry.se3`, which maps these kernels over
arrays. Closed forms are written in the Stumpff functions ``c_k(t) = sum_j (-t)^j / (2 j + k)!`` of
the squared angle ``t = |w|^2`` (c_0 = cos, c_1 = sinc, ...), which have no singularity at zero.

References: Barfoot, State Estimation for Robotics, chapter 8 (there in the order [u; w]);
Chirikjian, Stochastic Models, Information Theory, and Lie Groups 2, chapter 10.
"""

import math

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.numerics.fast_math import TAN_PI_8

#: (1 - atan(x)/x) / x^2 as a polynomial in x^2, |x| <= tan(pi/8): Chebyshev interpolation, 6e-17.
#: Source: numerical: minimax polynomial.
_ATAN = (
    *(0.3333333333333333, -0.1999999999999552, 0.14285714284666542, -0.11111111015256361),
    *(0.09090904578123903, -0.07692183190826087, 0.06664511447381948, -0.0585814891280221),
    *(0.0508544973794026, -0.03923165829558719, 0.01917688711906226),
)


@compiled
def stumpff_kernel(t: float) -> tuple[float, float, float, float, float, float]:
    """The Stumpff functions (c_1, ..., c_6) of a squared angle ``t >= 0``."""
    if t < 1.0:
        # Series of the two highest, then downwards: c_k = 1/k! - t c_{k+2} loses no digits.
        c5, c6, term5, term6 = 0.0, 0.0, 1.0 / 120.0, 1.0 / 720.0
        for j in range(9):
            c5 += term5
            c6 += term6
            term5 *= -t / ((2 * j + 6) * (2 * j + 7))
            term6 *= -t / ((2 * j + 7) * (2 * j + 8))
        c4 = 1.0 / 24.0 - t * c6
        c3 = 1.0 / 6.0 - t * c5
        return 1.0 - t * c3, 0.5 - t * c4, c3, c4, c5, c6
    angle = math.sqrt(t)
    c1 = math.sin(angle) / angle
    c2 = 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    c3 = (1.0 - c1) / t
    c4 = (0.5 - c2) / t
    return c1, c2, c3, c4, (1.0 / 6.0 - c3) / t, (1.0 / 24.0 - c4) / t


@compiled
def quaternion_kernel(R: Array) -> tuple[float, float, float, float]:
    """The unit quaternion (w, x, y, z), ``w >= 0``, of the rotation in ``R[:3, :3]``.

    Divides by the largest of the four components (Shepperd), so it is exact at any angle.
    """
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    if trace >= max(R[0, 0], R[1, 1], R[2, 2]):
        w, x = 1.0 + trace, R[2, 1] - R[1, 2]
        y, z = R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    elif R[0, 0] >= R[1, 1] and R[0, 0] >= R[2, 2]:
        w, x = R[2, 1] - R[1, 2], 1.0 + R[0, 0] - R[1, 1] - R[2, 2]
        y, z = R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]
    elif R[1, 1] >= R[2, 2]:
        w, x = R[0, 2] - R[2, 0], R[1, 0] + R[0, 1]
        y, z = 1.0 + R[1, 1] - R[0, 0] - R[2, 2], R[2, 1] + R[1, 2]
    else:
        w, x = R[1, 0] - R[0, 1], R[0, 2] + R[2, 0]
        y, z = R[2, 1] + R[1, 2], 1.0 + R[2, 2] - R[0, 0] - R[1, 1]
    scale = math.copysign(1.0 / math.sqrt(w * w + x * x + y * y + z * z), w)
    return w * scale, x * scale, y * scale, z * scale


@compiled
def rotation_kernel(wxyz: Array, R: Array) -> None:
    """Writes the rotation of a quaternion, of any length, into the upper left of a matrix."""
    w, x, y, z = wxyz[0], wxyz[1], wxyz[2], wxyz[3]
    s = 2.0 / (w * w + x * x + y * y + z * z)
    R[0, 0], R[0, 1], R[0, 2] = 1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)
    R[1, 0], R[1, 1], R[1, 2] = s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)
    R[2, 0], R[2, 1], R[2, 2] = s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)


@compiled(inline="always")
def half_angle_kernel(w: float, s: float) -> tuple[float, float]:
    """(h / s, (1 - h w / s) / s^2) for the half angle ``h = atan2(s, w)``, ``w, s >= 0``.

    ``w`` and ``s`` are the real and the length of the imaginary part of a unit quaternion. Free
    of branches and library calls, so that loops over it can be vectorised.
    """
    near, far = s <= TAN_PI_8 * w, w < TAN_PI_8 * s
    x = (s if near else (-w if far else s - w)) / (w if near else (s if far else s + w))
    offset = 0.0 if near else (0.5 * math.pi if far else 0.25 * math.pi)
    z = x * x
    p = _ATAN[10]
    p = p * z + _ATAN[9]
    p = p * z + _ATAN[8]
    p = p * z + _ATAN[7]
    p = p * z + _ATAN[6]
    p = p * z + _ATAN[5]
    p = p * z + _ATAN[4]
    p = p * z + _ATAN[3]
    p = p * z + _ATAN[2]
    p = p * z + _ATAN[1]
    p = p * z + _ATAN[0]
    inverse = 1.0 / (w if near else s)
    ratio = (1.0 - z * p if near else offset + x * (1.0 - z * p)) * inverse
    # Below pi/8 the difference 1 - h w / s cancels; there it is exactly (s / w)^2 p.
    return ratio, (p if near else 1.0 - ratio * w) * inverse * inverse


@compiled(inline="always")
def quaternion_log_kernel(
    w: float, x: float, y: float, z: float, px: float, py: float, pz: float
) -> tuple[float, float, float, float, float, float]:
    """Tangent vector of the pose with unit quaternion (w >= 0, x, y, z) and translation p."""
    ratio, k = half_angle_kernel(w, math.sqrt(x * x + y * y + z * z))
    # A^-1 p = p - w x p / 2 + c w x (w x p) with the rotation vector w = 2 (h/s) [x, y, z].
    ax, ay, az = y * pz - z * py, z * px - x * pz, x * py - y * px
    return (
        2.0 * ratio * x,
        2.0 * ratio * y,
        2.0 * ratio * z,
        px - ratio * ax + k * (y * az - z * ay),
        py - ratio * ay + k * (z * ax - x * az),
        pz - ratio * az + k * (x * ay - y * ax),
    )


# Plain loops instead of array expressions below: they compile several times faster.


@compiled
def _add_angular(out: Array, row: int, column: int, w: Array, a: float, b: float) -> None:
    """Adds a hat(w) + b hat(w)^2 to the 3x3 block of ``out`` that starts at row, column."""
    t = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[row + i, column + i] += b * (w[i] * w[i] - t)
        out[row + i, column + j] += b * w[i] * w[j] - a * w[k]
        out[row + i, column + k] += b * w[i] * w[k] + a * w[j]


@compiled
def so3_exp_kernel(w: Array) -> Array:
    """Rotation matrix (3, 3) of a rotation vector (3,)."""
    c = stumpff_kernel(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    out = np.zeros((3, 3))
    _add_angular(out, 0, 0, w, c[0], c[1])
    for i in range(3):
        out[i, i] += 1.0
    return out


@compiled
def so3_log_kernel(R: Array) -> Array:
    """Rotation vector (3,), of length at most pi, of the rotation in ``R[:3, :3]``."""
    w, x, y, z = quaternion_kernel(R)
    ratio, _ = half_angle_kernel(w, math.sqrt(x * x + y * y + z * z))
    out = np.empty(3)
    out[0], out[1], out[2] = 2.0 * ratio * x, 2.0 * ratio * y, 2.0 * ratio * z
    return out


@compiled
def exp_kernel(v: Array) -> Array:
    """Pose (4, 4) of a tangent vector (6,)."""
    c = stumpff_kernel(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    out = np.zeros((4, 4))
    _add_angular(out, 0, 0, v, c[0], c[1])
    for i in range(4):
        out[i, i] += 1.0
    # A u = u + c_2 w x u + c_3 w (w . u) - c_3 t u, where 1 - c_3 t = c_1.
    d = v[0] * v[3] + v[1] * v[4] + v[2] * v[5]
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        cross = v[j] * v[3 + k] - v[k] * v[3 + j]
        out[i, 3] = c[0] * v[3 + i] + c[1] * cross + c[2] * d * v[i]
    return out


@compiled
def log_kernel(X: Array) -> Array:
    """Tangent vector (6,) of a pose (4, 4); its angular part is at most pi long."""
    w, x, y, z = quaternion_kernel(X)
    v = quaternion_log_kernel(w, x, y, z, X[0, 3], X[1, 3], X[2, 3])
    out = np.empty(6)
    out[0], out[1], out[2], out[3], out[4], out[5] = v
    return out


@compiled
def inverse_kernel(X: Array) -> Array:
    """Inverse of a pose (4, 4)."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = X[j, i]
            out[i, 3] -= X[j, i] * X[j, 3]
    out[3, 3] = 1.0
    return out


@compiled
def compose_kernel(X: Array, Y: Array) -> Array:
    """Product (4, 4) of two poses, without the detour of a general matrix product."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(4):
            out[i, j] = X[i, 0] * Y[0, j] + X[i, 1] * Y[1, j] + X[i, 2] * Y[2, j]
        out[i, 3] += X[i, 3]
    out[3, 3] = 1.0
    return out


@compiled
def right_jacobian_inverse_kernel(v: Array) -> Array:
    """J_r^-1 (6, 6): ``log(exp(v) exp(e)) = v + J_r^-1(v) e`` to first order.

    [[M, 0], [dM, M]] with M = I + hat(w) / 2 + b hat(w)^2 and dM its derivative along u, which is
    -M Q M with Barfoot's Q (eq. 8.91). Singular at a rotation of 2 pi only.
    """
    d = v[0] * v[3] + v[1] * v[4] + v[2] * v[5]
    _, c2, c3, c4, c5, c6 = stumpff_kernel(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    b = (c3 - 2.0 * c4) / (2.0 * c2)
    # Twice the derivative of b with respect to t = |w|^2.
    db = (5.0 * c5 - c4 - 8.0 * c6) / (2.0 * c2) + 2.0 * b * b
    out = np.zeros((6, 6))
    _add_angular(out, 0, 0, v, 0.5, b)
    _add_angular(out, 3, 3, v, 0.5, b)
    _add_angular(out, 3, 0, v, 0.0, db * d)
    _add_angular(out, 3, 0, v[3:], 0.5, 0.0)
    for i in range(3):
        out[i, i] += 1.0
        out[3 + i, 3 + i] += 1.0
        out[3 + i, i] -= 2.0 * b * d
        for j in range(3):
            out[3 + i, j] += b * (v[i] * v[3 + j] + v[3 + i] * v[j])
    return out
