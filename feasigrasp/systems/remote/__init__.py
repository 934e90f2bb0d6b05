"""Perception and planning in separate processes, asynchronous to control."""
