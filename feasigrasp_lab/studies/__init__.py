"""Evaluations: how well it works."""
