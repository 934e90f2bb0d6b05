"""Limits and clearances as a quadratic program."""
