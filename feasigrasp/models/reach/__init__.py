"""What the arm can reach, now and soon."""
