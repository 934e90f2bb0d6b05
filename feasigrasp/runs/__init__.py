"""Runs of scenarios: one run, its record, its metrics, its pictures and its replay."""
