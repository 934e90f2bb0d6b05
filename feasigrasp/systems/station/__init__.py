"""The robot cell as a diagram."""
