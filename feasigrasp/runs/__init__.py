"""Runs of scenarios, and what is recorded of them."""
