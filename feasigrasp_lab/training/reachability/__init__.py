"""Fitting the reachable space of an arm."""
