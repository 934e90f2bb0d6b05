"""Evaluation commands of the arm alone."""
