"""Sine and cosine together, in a form that compilers can vectorise.

As in `fast_exp`: numba installs from PyPI without Intel's SVML, so ``math.sin`` stays a scalar call
and keeps the loop around it scalar. The function below is plain arithmetic without branches: range
reduction ``x = k pi/2 + f`` with ``|f| <= pi/4``, the Taylor polynomials of ``sin f`` and ``cos f``
(degrees 17 and 18, remainders below 1e-18), and ``k mod 4`` says which of the two is meant and
with which sign.
"""

from math import factorial

import numpy as np
from numba import njit

_TWO_OVER_PI = 0.6366197723675814
# The hexadecimal digits of pi/2 in three parts; the first two have so few bits that k times them is
# exact for |k| < 2^20.
_PI_2_HIGH = float.fromhex("0x1.921fb544p0")
_PI_2_MIDDLE = float.fromhex("0x0.42d18469p-32")
_PI_2_LOW = float.fromhex("0x0.898cc51701b83p-64")
# Adding 1.5 * 2^52 rounds to an integer, whose two's complement is then in the low mantissa bits.
_TO_BITS = 6755399441055744.0
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = (
    (-1.0) ** i / factorial(2 * i + 1) for i in range(1, 9)
)
_C4, _C6, _C8, _C10, _C12, _C14, _C16, _C18 = ((-1.0) ** i / factorial(2 * i) for i in range(2, 10))


# Inlined by LLVM, so that it keeps its own flags wherever it is called: with "reassoc" the compiler
# would join the parts of pi/2 again and cancel the rounding.
@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy", forceinline=True)
def fast_sincos(x: float) -> tuple[float, float]:
    """``sin x`` and ``cos x`` for ``|x| <= 1e6``, absolute error below 4e-16; NaN gives NaN."""
    rounded = x * _TWO_OVER_PI + _TO_BITS
    k = rounded - _TO_BITS
    f = ((x - k * _PI_2_HIGH) - k * _PI_2_MIDDLE) - k * _PI_2_LOW
    z = f * f
    p = _S15 + z * _S17
    p = _S13 + z * p
    p = _S11 + z * p
    p = _S9 + z * p
    p = _S7 + z * p
    p = _S5 + z * p
    p = _S3 + z * p
    sine = f + f * z * p
    p = _C16 + z * _C18
    p = _C14 + z * p
    p = _C12 + z * p
    p = _C10 + z * p
    p = _C8 + z * p
    p = _C6 + z * p
    p = _C4 + z * p
    cosine = 1.0 + z * (z * p - 0.5)
    bits = np.float64(rounded).view(np.int64)
    if bits & 1:
        sine, cosine = cosine, sine
    if bits & 2:
        sine = -sine
    if (bits + 1) & 2:
        cosine = -cosine
    return sine, cosine


@njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
def sincos_kernel(x, sine, cosine):
    """Writes the sines and cosines of an array (n,)."""
    for i in range(len(x)):
        sine[i], cosine[i] = fast_sincos(x[i])
