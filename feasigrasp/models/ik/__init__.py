"""Inverse kinematics of the arm."""
