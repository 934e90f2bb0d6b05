"""Control in task space."""
