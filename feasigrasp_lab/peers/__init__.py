"""Implementations of others, for comparison."""
