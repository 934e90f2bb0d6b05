"""Measures: how good a shape, a grasp, a score is."""
