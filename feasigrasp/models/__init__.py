"""The mathematics: NumPy, numba and torch only. Nothing in this package imports Drake."""
