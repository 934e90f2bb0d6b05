"""Stages of the pipeline as diagrams."""
