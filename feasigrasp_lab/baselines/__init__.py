"""Baseline controllers and samplers: nearest grasp, grasp diffusion."""
