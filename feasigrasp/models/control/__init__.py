"""Control laws of the arm."""
