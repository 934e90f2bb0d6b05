"""Square roots and exponentials for SIMD loops.

Three things slow a numba loop over floating-point pairs down: the compiler's preference for
256-bit registers on processors that have 512-bit ones, ``math.exp`` (a scalar call without Intel's
SVML), and the divider, which needs five times as long for a root and a reciprocal as for the
multiplications that replace them. The functions here are plain arithmetic without branches. They
are inlined with flags of their own: permission to reorder sums would fold the rounding trick of
`exp2_of_minus` away; callers stay free to use ``fastmath``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from feasigrasp.models.compiled import compiled, fused

#: Adding 1.5 * 2^52 rounds to a whole number and leaves it in the low mantissa bits.
_TO_BITS = 6755399441055744.0
#: Largest argument of `exp2_of_minus`.
MAX_EXPONENT = 1020.0
# 2^f on [-0.5, 0.5]: minimax in the relative error, 1.3e-14 (Remez exchange in 50 digits).
_E0, _E1, _E2, _E3, _E4, _E5, _E6, _E7, _E8, _E9 = (
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
# Halving the exponent of x by its bits gives 1/sqrt(x) to 3.4 %.
_HALVED = 0x5FE6EC85E7DE30DA
# 1/sqrt(1 - e) for the |e| < 0.0702 that this leaves: minimax in the relative error, 2.6e-8.
_S0, _S1, _S2, _S3, _S4 = (
    1.0000000007726003269,
    0.4999981214147179447,
    0.37499702349068071752,
    0.3140226288025275392,
    0.27508789921877799144,
)


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
    bits = _TO_BITS - r
    f = (_TO_BITS - bits) - r
    g = f * f
    even = fused(g, _E8, _E6)
    odd = fused(g, _E9, _E7)
    even = fused(g, even, _E4)
    odd = fused(g, odd, _E5)
    even = fused(g, even, _E2)
    odd = fused(g, odd, _E3)
    even = fused(g, even, _E0)
    odd = fused(g, odd, _E1)
    p = fused(f, odd, even)
    shifted = np.float64(p).view(np.int64) + (np.float64(bits).view(np.int64) << 52)
    return np.int64(shifted).view(np.float64)


@compiled(forceinline=True)
def rough_inverse_sqrt(x: float) -> float:
    """``1/sqrt(x)`` for normal ``x > 0`` to 2.6e-8; one Newton step makes it 1e-15."""
    y = np.int64(_HALVED - (np.float64(x).view(np.int64) >> 1)).view(np.float64)
    e = fused(-(x * y), y, 1.0)
    p = fused(e, _S4, _S3)
    p = fused(e, p, _S2)
    p = fused(e, p, _S1)
    p = fused(e, p, _S0)
    return y * p
