"""Benchmarks: how quick it is."""
