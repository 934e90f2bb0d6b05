"""Torch modules of the grasp networks, for training and comparison."""
