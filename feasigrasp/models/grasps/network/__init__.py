"""The equivariant network that proposes grasps."""
