"""Multiply and add with one rounding, written out where compiled code needs it.

``fastmath={"contract"}`` lets the compiler fuse wherever it likes: two copies of a function, one
compiled by itself and one inside its caller, then differ in the last bit, and which of them runs
depends on what was loaded first. Written out, it is as fast and the same everywhere.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


def _fused(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


#: ``fused(a, b, c)`` is ``a b + c`` of floats, rounded once, in compiled code.
fused: Any = intrinsic(_fused)
