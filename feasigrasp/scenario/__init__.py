"""Scenarios: the YAML format of what is run."""
