"""Pictures of what was perceived."""
