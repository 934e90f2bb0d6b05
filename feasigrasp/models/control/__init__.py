"""Control laws of the arm."""

from feasigrasp.models.control.joint.law import JointControlOptions
from feasigrasp.models.control.safety.safe_velocity import Safety, SafetyOptions
from feasigrasp.models.control.task.safe_law import TaskControlOptions

__all__ = ["JointControlOptions", "Safety", "SafetyOptions", "TaskControlOptions"]
