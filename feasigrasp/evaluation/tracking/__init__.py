"""Recordings of the wrist camera, and trackers judged on them."""
