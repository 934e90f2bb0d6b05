"""Control laws of the arm."""

from feasigrasp.models.control.joint.law import JointControlOptions
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.control.task.safe_law import TaskControlOptions

__all__ = ["JointControlOptions", "Safety", "SafetyFilter", "SafetyOptions", "TaskControlOptions"]

#: The former name of `SafetyFilter`, until the next release.
Safety = SafetyFilter
