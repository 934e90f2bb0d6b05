"""The commands that measure the arm itself: no grasp, no camera, no controller."""
