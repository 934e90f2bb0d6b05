"""Perception and planning in processes of their own: control never waits for them."""
