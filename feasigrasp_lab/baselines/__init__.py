"""Controllers and samplers to compare with: nearest grasp, grasp diffusion."""
