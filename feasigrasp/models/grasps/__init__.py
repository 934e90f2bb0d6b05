"""Grasps: proposing, filtering, scoring, following through."""
