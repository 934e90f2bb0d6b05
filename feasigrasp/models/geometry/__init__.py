"""Rigid motions and points."""

from feasigrasp.models.geometry import se3

__all__ = ["se3"]
