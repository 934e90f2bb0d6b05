"""Stages of the whole pipeline: which systems each is made of, and how they are connected."""
