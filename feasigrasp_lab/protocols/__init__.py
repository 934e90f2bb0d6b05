"""Evaluation protocols: speeds, degradations, rules of a test."""
