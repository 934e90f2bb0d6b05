"""Algorithms for the arm that studies and training use, and no run."""
