"""Vectorizable elementary functions: roots, exponentials, sine and cosine, arctangent.

numba installs from PyPI without Intel's SVML, so ``math.exp``, ``math.sin`` and ``math.atan2`` stay
scalar calls and keep the whole loop around them scalar. The functions below are plain arithmetic
without branches.

They are inlined with flags of their own: permission to reorder sums would fold the rounding trick
of `exp2_of_minus` away; callers stay free to use ``fastmath``.
"""

from math import factorial
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.polynomial import Chebyshev, Polynomial

from feasigrasp.models.compiled import compiled, fused

#: Adding 1.5 * 2^52 rounds to a whole number and leaves it in the low mantissa bits. Source:
#: numerical.
_TO_BITS = 6755399441055744.0
#: Largest argument of `exp2_of_minus`. Source: numerical.
MAX_EXPONENT = 1020.0


def _wide_vectors(typing_context: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        # llvmlite refuses attributes it does not know, as a set it takes them.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.none(), generate


#: ``wide_vectors()`` asks the compiler for 512-bit registers in the function that calls it, where
#: there are any. LLVM avoids them on Intel's servers of 2017 to 2022, whose clock drops with
#: them; these loops still gain 1.6 times there. It has to stand in the function with the loop, and
#: in whatever that is inlined into.
wide_vectors: Any = intrinsic(_wide_vectors)


@compiled(forceinline=True)
def exp2_of_minus(r: float) -> float:
    """``2^-r`` for ``|r| <= MAX_EXPONENT``, relative error 1.4e-14; nonsense beyond it.

    With u = round(-r) and the rest f in [-0.5, 0.5]: the polynomial of 2^f, its even and odd part
    apart to halve the chain of dependent operations, and u added to the exponent bits.
    """
    # 2^f on [-0.5, 0.5]: minimax in the relative error, 1.3e-14 (Remez exchange in 50 digits).
    e0, e1, simd_e2, simd_e3, simd_e4, simd_e5, simd_e6, simd_e7, simd_e8, simd_e9 = (
        1.0000000000000127617,
        0.69314718055987097774,
        0.24022650695649659194,
        0.055504108668685273599,
        0.0096181291920658570673,
        0.0013333557617650289136,
        0.00015403434948994396279,
        0.000015252984814882096451,
        1.3259405424714457925e-6,
        1.0150340875467397667e-7,
    )
    bits = _TO_BITS - r
    f = (_TO_BITS - bits) - r
    g = f * f
    even = fused(g, simd_e8, simd_e6)
    odd = fused(g, simd_e9, simd_e7)
    even = fused(g, even, simd_e4)
    odd = fused(g, odd, simd_e5)
    even = fused(g, even, simd_e2)
    odd = fused(g, odd, simd_e3)
    even = fused(g, even, e0)
    odd = fused(g, odd, e1)
    p = fused(f, odd, even)
    shifted = np.float64(p).view(np.int64) + (np.float64(bits).view(np.int64) << 52)
    return np.int64(shifted).view(np.float64)


@compiled(forceinline=True)
def rough_inverse_sqrt(x: float) -> float:
    """``1/sqrt(x)`` for normal ``x > 0`` to 2.6e-8; one Newton step makes it 1e-15.

    The divider needs five times as long for a root and a reciprocal as these multiplications.
    """
    # 1/sqrt(1 - e) for the |e| < 0.0702 that this leaves: minimax in the relative error, 2.6e-8.
    s0, s1, s2, s3, s4 = (
        1.0000000007726003269,
        0.4999981214147179447,
        0.37499702349068071752,
        0.3140226288025275392,
        0.27508789921877799144,
    )
    # Halving the exponent of x by its bits gives 1/sqrt(x) to 3.4 %.
    y = np.int64(0x5FE6EC85E7DE30DA - (np.float64(x).view(np.int64) >> 1)).view(np.float64)
    e = fused(-(x * y), y, 1.0)
    p = fused(e, s4, s3)
    p = fused(e, p, s2)
    p = fused(e, p, s1)
    p = fused(e, p, s0)
    return y * p


#: ln 2 in two parts, so that x - k ln 2 loses nothing for the |k| < 1100 that can occur. Source:
#: numerical.
_LN2_HIGH = 6.93145751953125e-1
_LN2_LOW = 1.42860682030941723212e-6
#: Arguments are not taken for less: the exponential would be below any number. Source: numerical.
_LOWEST = -708.0
_E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9, _E10, _E11, _E12 = (
    1.0 / factorial(i) for i in range(2, 13)
)

# The hexadecimal digits of pi/2 in three parts; the first two have so few bits that k times them is
# exact for |k| < 2^20.
_PI_2_HIGH = float.fromhex("0x1.921fb544p0")
_PI_2_MIDDLE = float.fromhex("0x0.42d18469p-32")
_PI_2_LOW = float.fromhex("0x0.898cc51701b83p-64")
_S3, _S5, _S7, _S9, _S11, _S13, _S15, _S17 = (
    (-1.0) ** i / factorial(2 * i + 1) for i in range(1, 9)
)
_C4, _C6, _C8, _C10, _C12, _C14, _C16, _C18 = ((-1.0) ** i / factorial(2 * i) for i in range(2, 10))

#: Arctangent: the ratio of the smaller to the larger argument, turned by 45 degrees where it
#: exceeds tan(22.5 deg), is t with |t| <= tan(22.5 deg); there atan(t) / t is a polynomial in t^2.
#: Source: formula.
TAN_PI_8 = float(np.sqrt(2.0) - 1.0)
# Interpolation at 13 Chebyshev nodes: remainder below 1e-17, since the nearest singularity of
# atan(sqrt z) / sqrt z lies at z = -1.
_A0, _A1, _A2, _A3, _A4, _A5, _A6, _A7, _A8, _A9, _A10, _A11, _A12 = (
    float(c)
    for c in Chebyshev.interpolate(
        lambda z: np.arctan(np.sqrt(z)) / np.sqrt(z), 12, [0.0, TAN_PI_8**2]
    )
    .convert(kind=Polynomial)
    .coef
)


@compiled(inline="always", fastmath=True)
def fast_exp(x: float) -> float:
    """``e^x`` for finite ``x <= 700``; below -708 it stays at ``e^-708 = 3e-308``.

    Relative error 4e-16, growing to 1e-13 where ``|x|`` is several hundred (the compiler may fuse
    the two parts of ln 2).
    """
    x = max(x, _LOWEST)
    # Exponential: x = k ln 2 + f with |f| <= ln(2) / 2, the Taylor polynomial of e^f (degree 12,
    # remainder 2e-16), and the factor 2^k written into the exponent bits.
    k = np.floor(x * 1.4426950408889634 + 0.5)
    f = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = _E11 + f * _E12
    p = _E10 + f * p
    p = _E9 + f * p
    p = _E8 + f * p
    p = _E7 + f * p
    p = _E6 + f * p
    p = _E5 + f * p
    p = _E4 + f * p
    p = _E3 + f * p
    p = _E2 + f * p
    p = 1.0 + f * (1.0 + f * p)
    bits = np.float64(k + _TO_BITS).view(np.int64)
    scale = np.int64((bits + 1023) << 52).view(np.float64)
    return p * scale


# Inlined by LLVM, so that it keeps its own flags wherever it is called: with "reassoc" the compiler
# would join the parts of pi/2 again and cancel the rounding.
@compiled(forceinline=True)
def fast_sincos(x: float) -> tuple[float, float]:
    """``sin x`` and ``cos x`` for ``|x| <= 1e6``, absolute error below 4e-16; NaN gives NaN."""
    # Sine and cosine: x = k pi/2 + f with |f| <= pi/4, the Taylor polynomials of sin f and cos f
    # (degrees 17 and 18, remainders below 1e-18), and k mod 4 says which of the two, with which
    # sign.
    rounded = fused(x, 0.6366197723675814, _TO_BITS)
    k = rounded - _TO_BITS
    f = fused(-k, _PI_2_LOW, fused(-k, _PI_2_MIDDLE, fused(-k, _PI_2_HIGH, x)))
    z = f * f
    p = fused(z, _S17, _S15)
    p = fused(z, p, _S13)
    p = fused(z, p, _S11)
    p = fused(z, p, _S9)
    p = fused(z, p, _S7)
    p = fused(z, p, _S5)
    p = fused(z, p, _S3)
    sine = fused(f * z, p, f)
    p = fused(z, _C18, _C16)
    p = fused(z, p, _C14)
    p = fused(z, p, _C12)
    p = fused(z, p, _C10)
    p = fused(z, p, _C8)
    p = fused(z, p, _C6)
    p = fused(z, p, _C4)
    cosine = fused(z, fused(z, p, -0.5), 1.0)
    bits = np.float64(rounded).view(np.int64)
    if bits & 1:
        sine, cosine = cosine, sine
    if bits & 2:
        sine = -sine
    if (bits + 1) & 2:
        cosine = -cosine
    return sine, cosine


@compiled(forceinline=True)
def fast_atan2(y: float, x: float) -> float:
    """``atan2(y, x)`` for finite arguments, within 1e-15; in (-pi, pi], 0 at the origin.

    The sign of a zero is not looked at: ``fast_atan2(-0.0, -1.0)`` is ``pi``.
    """
    ax, ay = abs(x), abs(y)
    low, high = min(ax, ay), max(ax, ay)
    turned = low > TAN_PI_8 * high
    numerator = low - high if turned else low
    denominator = low + high if turned else high
    t = numerator / max(denominator, 1e-300)  # keeps 0 / 0 away; atan2(0, 0) is 0
    z = t * t
    p = fused(z, _A12, _A11)
    p = fused(z, p, _A10)
    p = fused(z, p, _A9)
    p = fused(z, p, _A8)
    p = fused(z, p, _A7)
    p = fused(z, p, _A6)
    p = fused(z, p, _A5)
    p = fused(z, p, _A4)
    p = fused(z, p, _A3)
    p = fused(z, p, _A2)
    p = fused(z, p, _A1)
    p = fused(z, p, _A0)
    angle = fused(t, p, 0.25 * np.pi if turned else 0.0)
    angle = 0.5 * np.pi - angle if ay > ax else angle
    angle = np.pi - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle
