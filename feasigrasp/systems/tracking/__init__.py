"""Tracking with the robot's own camera."""
