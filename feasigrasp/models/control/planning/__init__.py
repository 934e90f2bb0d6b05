"""What goes with a plan: clearances, what the camera sees, where to look, reaction to contact."""
