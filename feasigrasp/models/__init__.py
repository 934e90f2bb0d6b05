"""The mathematics: NumPy, SciPy and numba. Nothing in this package imports Drake."""
