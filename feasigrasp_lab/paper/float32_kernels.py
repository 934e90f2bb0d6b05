"""Single-precision density of a Riemannian mixture for blocks of poses.

They serve millions of poses, where speed decides and an error of 1e-5 in a log density does not
matter; `feasigrasp_lab.mixtures.mixture` has the exact ones for one pose at a time. What makes them
fast:

* Structure of arrays: a block of poses is ``(7, BLOCK)``, quaternion wxyz and position, so that
  the compiler turns every loop over the poses into SIMD code.
* No arc tangent, square root or division in the logarithm. With the relative quaternion
  ``(w, a)``, ``w = cos h``, both ``f = h / sin h`` and ``g = (1 - h cot h) / sin^2 h`` are analytic
  in ``w`` on [0, 1] (the nearest singularity is ``w = -1``): two polynomials of degree 7.
* With ``u = R_mu^T (p - p_mu)``, the translational part is ``f (w u - a x u) + g (a . u) a``.
* Densities are in units of log 2, which saves a product in the exponential.
* A responsibility below ``2^-20`` counts as zero, exactly: this also keeps denormal numbers, which
  are a hundred times slower, out of the sums.
"""

import math

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike, NDArray

from feasigrasp.errors import GraspError
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import quaternion_kernel
from feasigrasp.models.numerics.fast_math import wide_vectors
from feasigrasp_lab.mixtures.mixture import RiemannianMixture

Float32Array = NDArray[np.float32]

#: log2 of the responsibility below which a component counts as not responsible at all. Source:
#: numerical.
LOG2_TOLERANCE = -20
#: Poses per block, a constant of the code: with a length known only at run time, the compiler does
#: not turn `tangents_kernel` into SIMD code. Source: numerical.
BLOCK = 256

FASTMATH = {"contract", "reassoc", "nsz", "arcp"}
_f4 = np.float32
#: Numbers of single precision. Source: layout.
_ZERO, _HALF, _ONE = _f4(0.0), _f4(0.5), _f4(1.0)
_TOLERANCE, _LOWEST, _BIAS = _f4(LOG2_TOLERANCE), _f4(-126.0), np.int32(127)
#: 2^f on [-1/2, 1/2] by its Taylor polynomial, relative error 2e-7. Source: numerical.
_E = tuple(_f4(math.log(2.0) ** i / math.factorial(i)) for i in range(7))
_E0, _E1, _E2, _E3, _E4, _E5, _E6 = _E


def _log_polynomials() -> tuple[list[np.float32], list[np.float32]]:
    """Coefficients of f and g in powers of ``w - 1/2``, by interpolation at Chebyshev nodes.

    Errors on [0, 1]: 8e-7 and 5e-6.
    """
    degree = 7
    nodes = np.cos((np.arange(degree + 1) + 0.5) * np.pi / (degree + 1))
    h = 2.0 * np.arcsin(np.sqrt((1.0 - nodes) / 4.0))  # w = (1 + node) / 2 = cos h
    f, g = h / np.sin(h), (1.0 - h / np.tan(h)) / np.sin(h) ** 2
    powers = 2.0 ** np.arange(degree + 1)
    fitted = [chebyshev.cheb2poly(chebyshev.chebfit(nodes, y, degree)) * powers for y in (f, g)]
    return [_f4(c) for c in fitted[0]], [_f4(c) for c in fitted[1]]


_F, _G = _log_polynomials()
_F0, _F1, _F2, _F3, _F4, _F5, _F6, _F7 = _F
_G0, _G1, _G2, _G3, _G4, _G5, _G6, _G7 = _G


def pack(mixture: RiemannianMixture) -> Float32Array:
    """The mixture as the kernels take it, shape (K, 38)."""
    log_weights, means, quaternions, whitening, log_normalisers = mixture.parameters
    R, p = means[:, :3, :3], means[:, :3, 3]
    # Entries per packed component: quaternion, R^T row by row, R^T p, whitening factor, constant.
    packed = np.empty((len(mixture), 4 + 9 + 3 + 21 + 1))
    packed[:, :4] = quaternions
    packed[:, 4:13] = R.swapaxes(1, 2).reshape(-1, 9)
    packed[:, 13:16] = np.einsum("kij,ki->kj", R, p)
    rows, columns = np.tril_indices(6)
    packed[:, 16:37] = whitening[:, rows, columns] * math.sqrt(0.5 / math.log(2.0))
    # A switched-off component (weight 0) gets a log density that loses against any other.
    packed[:, 37] = np.maximum((log_weights + log_normalisers) / math.log(2.0), -1e30)
    result = packed.astype(np.float32)
    result.flags.writeable = False
    return result


@compiled(forceinline=True, fastmath=FASTMATH)
def tangents_kernel(x, c, out):
    """Writes Log(mu^-1 x), shape (6, BLOCK), of a block (7, BLOCK) for one packed component."""
    wide_vectors()
    mw, mx, my, mz = c[0], c[1], c[2], c[3]
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = c[4], c[5], c[6], c[7], c[8], c[9], c[10], c[11], c[12]
    t0, t1, t2 = c[13], c[14], c[15]
    x0, x1, x2, x3, x4, x5, x6 = x[0], x[1], x[2], x[3], x[4], x[5], x[6]
    o0, o1, o2, o3, o4, o5 = out[0], out[1], out[2], out[3], out[4], out[5]
    for j in range(BLOCK):
        q0, q1, q2, q3 = x0[j], x1[j], x2[j], x3[j]
        w = mw * q0 + mx * q1 + my * q2 + mz * q3
        a = mw * q1 - mx * q0 - my * q3 + mz * q2
        b = mw * q2 - my * q0 - mz * q1 + mx * q3
        d = mw * q3 - mz * q0 - mx * q2 + my * q1
        px, py, pz = x4[j], x5[j], x6[j]
        ux = r0 * px + r1 * py + r2 * pz - t0
        uy = r3 * px + r4 * py + r5 * pz - t1
        uz = r6 * px + r7 * py + r8 * pz - t2
        # Estrin's scheme: short chains of dependent operations, unlike Horner's.
        s = abs(w) - _HALF
        s2 = s * s
        s4 = s2 * s2
        f = ((_F0 + s * _F1) + s2 * (_F2 + s * _F3)) + s4 * ((_F4 + s * _F5) + s2 * (_F6 + s * _F7))
        g = ((_G0 + s * _G1) + s2 * (_G2 + s * _G3)) + s4 * ((_G4 + s * _G5) + s2 * (_G6 + s * _G7))
        f = f if w >= _ZERO else -f  # q and -q are the same rotation: take the shorter way
        h = g * (a * ux + b * uy + d * uz)
        twice = f + f
        o0[j] = twice * a
        o1[j] = twice * b
        o2[j] = twice * d
        o3[j] = f * (w * ux - b * uz + d * uy) + h * a
        o4[j] = f * (w * uy - d * ux + a * uz) + h * b
        o5[j] = f * (w * uz - a * uy + b * ux) + h * d


@compiled(forceinline=True, fastmath=FASTMATH)
def log2_density_kernel(v, c, largest, out):
    """Writes log2 densities (BLOCK,) of tangents (6, BLOCK); raises ``largest`` (BLOCK,)."""
    wide_vectors()
    v0, v1, v2, v3, v4, v5 = v[0], v[1], v[2], v[3], v[4], v[5]
    k = c[37]
    for j in range(BLOCK):
        a0, a1, a2, a3, a4, a5 = v0[j], v1[j], v2[j], v3[j], v4[j], v5[j]
        z0 = c[16] * a0
        z1 = c[17] * a0 + c[18] * a1
        z2 = c[19] * a0 + c[20] * a1 + c[21] * a2
        z3 = c[22] * a0 + c[23] * a1 + c[24] * a2 + c[25] * a3
        z4 = c[26] * a0 + c[27] * a1 + c[28] * a2 + c[29] * a3 + c[30] * a4
        z5 = c[31] * a0 + c[32] * a1 + c[33] * a2 + c[34] * a3 + c[35] * a4 + c[36] * a5
        log2 = k - (z0 * z0 + z1 * z1 + z2 * z2 + z3 * z3 + z4 * z4 + z5 * z5)
        out[j] = log2
        largest[j] = max(largest[j], log2)


@compiled(inline="always", fastmath=FASTMATH)
def _exp2(x):
    """2^x for x <= 0; 2^-126 below that."""
    x = max(x, _LOWEST)
    k = np.floor(x + _HALF)
    f = x - k
    f2 = f * f
    p = (_E0 + f * _E1) + f2 * (_E2 + f * _E3) + f2 * f2 * ((_E4 + f * _E5) + f2 * _E6)
    return p * np.int32((np.int32(k) + _BIAS) << np.int32(23)).view(np.float32)


@compiled(forceinline=True, fastmath=FASTMATH)
def exponentials_kernel(log2, largest, total):
    """Turns one component's log2 densities (BLOCK,) into their ratios to the largest of a pose.

    Adds them to ``total`` (BLOCK,). Ratios below the tolerance become zero; returns False, and
    leaves everything as it is, if all would.
    """
    wide_vectors()
    hits = _ZERO  # counted in float32: an integer count would not stay in SIMD registers
    for j in range(BLOCK):
        hits += _ONE if log2[j] - largest[j] > _TOLERANCE else _ZERO
    if hits == _ZERO:
        return False
    for j in range(BLOCK):
        x = log2[j] - largest[j]
        e = _exp2(x)
        e = e if x > _TOLERANCE else _ZERO
        log2[j] = e
        total[j] += e
    return True


@compiled(nogil=True)
def _log_densities(X, packed, out):
    """Log densities (n,) of poses (n, 4, 4), block by block."""
    wide_vectors()
    K = len(packed)
    block, v = np.empty((7, BLOCK), np.float32), np.empty((6, BLOCK), np.float32)
    log2, total = np.empty((K, BLOCK), np.float32), np.empty(BLOCK, np.float32)
    largest = np.empty(BLOCK, np.float32)
    for start in range(0, len(X), BLOCK):
        n = min(BLOCK, len(X) - start)
        largest[:], total[:] = -np.inf, 0.0
        for j in range(BLOCK):  # the last block is filled up with copies of the last pose
            pose = X[start + min(j, n - 1)]
            q = quaternion_kernel(pose)
            for i in range(4):
                block[i, j] = q[i]
            for i in range(3):
                block[4 + i, j] = pose[i, 3]
        for k in range(K):
            tangents_kernel(block, packed[k], v)
            log2_density_kernel(v, packed[k], largest, log2[k])
        for k in range(K):
            exponentials_kernel(log2[k], largest, total)
        for j in range(n):
            out[start + j] = (largest[j] + math.log2(total[j])) * math.log(2.0)
            finite = 0.0
            for i in range(7):
                finite += block[i, j]
            if not math.isfinite(finite):
                out[start + j] = math.nan


def log_densities(X: ArrayLike, packed: Float32Array) -> Array:
    """Log density of a packed mixture at poses, shape (n,); NaN for a pose that is not finite.

    Args:
        X: Poses, shape (n, 4, 4) [m].
        packed: The mixture, see `pack`.

    Raises:
        GraspError: ``X`` does not have shape (n, 4, 4).
    """
    X = np.ascontiguousarray(X, dtype=float)
    if X.ndim != 3 or X.shape[1:] != (4, 4):
        raise GraspError(f"log_densities: expected poses of shape (n, 4, 4), got {X.shape}.")
    out = np.empty(len(X))
    _log_densities(X, packed, out)
    return out
