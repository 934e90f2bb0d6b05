"""The numba decorator: cached, deterministic, independent of the first caller.

Where an option is left out, numba takes ``fastmath``, ``error_model`` and ``forceinline`` from the
function that happens to be compiled when this one is called for the first time; what the cache then
holds, and with it the last bits of every result, depends on the order of calls. So all three are
said here.

``fastmath`` leaves the last bits to the compiler. A function that is called by another one is in
the machine code of both, and which of the two copies runs depends on which was loaded first. So
what is relaxed is called by Python alone or inlined (``forceinline``) up to what is;
tests/models/test_compiled.py watches over it. `fused` is for the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit, types
from numba.extending import intrinsic


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of functions to compile: ``@compiled`` or ``@compiled(nogil=True)``.

    Division by zero gives infinity or NaN, as in NumPy.

    Args:
        function: What is decorated.
        options: Of ``numba.njit``, instead of what is set here.
    """
    ours: dict[str, Any] = {"cache": True, "error_model": "numpy"}
    ours |= {"fastmath": False, "forceinline": False}
    ours["no_cfunc_wrapper"] = True  # no function's address is taken; 6 % of the time to compile
    decorator: Any = njit(**(ours | options))
    return decorator if function is None else decorator(function)


# Multiply and add with one rounding. ``fastmath={"contract"}`` lets the compiler fuse wherever it
# likes: two copies of a function then differ in the last bit. Written out, it is the same anywhere.
def _fused(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


#: ``fused(a, b, c)`` is ``a b + c`` of floats, rounded once, in compiled code.
fused: Any = intrinsic(_fused)
