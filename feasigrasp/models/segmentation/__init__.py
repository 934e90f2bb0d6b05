"""Segmentation of the object in a depth image."""
