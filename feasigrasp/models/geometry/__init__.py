"""Rigid motions and points."""
