"""Inverse kinematics of the arm."""

from feasigrasp.models.ik.self_motion import closed_form

__all__ = ["closed_form"]
