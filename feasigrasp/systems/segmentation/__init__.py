"""Segmentation of the object in camera images."""
