"""Recordings of the wrist camera and of others, and trackers played or judged on them."""
