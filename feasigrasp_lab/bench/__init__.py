"""Benchmarks of computing times."""
