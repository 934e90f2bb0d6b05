"""Writes the description of the robot cell from the facts in feasigrasp.models."""
