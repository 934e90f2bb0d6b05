"""Fit of the reachable space of an arm."""
