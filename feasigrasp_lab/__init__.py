"""Measurements, training and comparisons of feasigrasp; no part of the run time."""

from pathlib import Path

#: Where the trained weights of its parts are.
WEIGHTS = Path(__file__).resolve().parent / "weights"
