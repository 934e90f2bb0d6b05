"""Inverse kinematics of the arm."""

from feasigrasp.models.ik.closed_form import closed_form
from feasigrasp.models.ik.flow import IkFlow

__all__ = ["IkFlow", "closed_form"]
