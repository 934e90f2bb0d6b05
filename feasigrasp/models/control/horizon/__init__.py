"""Receding-horizon control of the arm towards grasps of a moving object."""
