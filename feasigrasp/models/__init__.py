"""The mathematics: NumPy, numba and torch only. Nothing in this package imports Drake."""

from feasigrasp.kernel_cache import forget_stale

forget_stale()
