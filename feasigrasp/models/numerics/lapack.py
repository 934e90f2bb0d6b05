"""Cholesky factorization and triangular solves that let other Python threads run meanwhile.

The wrappers of ``scipy.linalg.lapack`` hold Python's lock for the whole call, so that a fit in a
worker thread would stop the simulation beside it. These call the same routines of the same library
by the addresses that SciPy publishes for compiled code, through ctypes, which releases the lock.

All matrices are in Fortran order, float64, and changed in their place.
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from scipy.linalg import cython_lapack

from feasigrasp.models.arrays import Array


def _routine(name: str, n_arguments: int) -> Any:
    """A LAPACK routine; all its arguments are addresses."""
    capsule = cython_lapack.__pyx_capi__[name]
    get_name = ctypes.pythonapi.PyCapsule_GetName
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    signature = get_name(capsule)
    if b"int *" not in signature:
        raise ImportError(f"scipy's {name} has another signature: {signature.decode()}")
    prototype = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * n_arguments)
    return prototype(get_pointer(capsule, signature))


_DPOTRF = _routine("dpotrf", 5)
_DPOTRS = _routine("dpotrs", 8)
_DTRTRS = _routine("dtrtrs", 10)


def factorize(A: Array) -> int:
    """Replaces the lower triangle of A (n, n) by its Cholesky factor L, ``A = L L^T``.

    Returns:
        0, or the order of the first leading minor that is not positive definite.
    """
    return _call(_DPOTRF, b"L", _size(A), _changed(A), _stride(A))


def solve_factorized(L: Array, B: Array) -> None:
    """Replaces B, shape (n, m), by ``(L L^T)^-1 B``."""
    _check(_call(_DPOTRS, b"L", *_system(L, B)))


def solve_lower(L: Array, B: Array) -> None:
    """Replaces B, shape (n, m), by ``L^-1 B``."""
    _check(_call(_DTRTRS, b"L", b"N", b"N", *_system(L, B)))


def _call(routine: Any, *arguments: bytes | int | Array) -> int:
    info = ctypes.c_int(0)
    kept: list[Any] = []  # alive until the routine returns
    for argument in arguments:
        if isinstance(argument, bytes):
            kept.append(ctypes.c_char_p(argument))
        elif isinstance(argument, int):
            kept.append(ctypes.byref(ctypes.c_int(argument)))
        else:
            kept.append(ctypes.c_void_p(argument.ctypes.data))
    routine(*kept, ctypes.byref(info))
    return info.value


def _size(A: Array) -> int:
    if A.ndim != 2 or A.shape[0] != A.shape[1] or A.dtype != np.float64:
        raise ValueError(f"matrix has shape {A.shape} and type {A.dtype}; give (n, n), float64")
    return len(A)


def _system(L: Array, B: Array) -> tuple[int | Array, ...]:
    """The arguments that describe a system with matrix L and right-hand sides B."""
    n = _size(L)
    if B.ndim != 2 or len(B) != n or B.dtype != np.float64:
        raise ValueError(f"right-hand sides have shape {B.shape}, type {B.dtype}; give ({n}, m)")
    return n, B.shape[1], L, _stride(L), _changed(B), _stride(B)


def _stride(A: Array) -> int:
    """Leading dimension: A may be a block of a larger matrix."""
    if A.strides[0] != A.itemsize and len(A) > 1:
        raise ValueError("matrix is not in Fortran order")
    return max(A.strides[1] // A.itemsize, len(A), 1)


def _changed(A: Array) -> Array:
    if not A.flags.writeable:
        raise ValueError("matrix is read-only")
    return A


def _check(info: int) -> None:
    if info != 0:
        raise ArithmeticError(f"triangular solve failed (LAPACK info {info}): zero on the diagonal")
