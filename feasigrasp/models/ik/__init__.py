"""Inverse kinematics of the arm."""

from feasigrasp.models.ik.closed_form import closed_form

__all__ = ["closed_form"]
