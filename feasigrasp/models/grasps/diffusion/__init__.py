"""Grasp diffusion, the baseline: a learned energy over hand poses, and how it is sampled."""
