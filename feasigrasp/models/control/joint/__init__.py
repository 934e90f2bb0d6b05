"""Control in joint space."""
