"""The equivariant grasp network."""
