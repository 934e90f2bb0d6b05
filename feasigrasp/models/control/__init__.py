"""Control laws of the arm."""

from feasigrasp.models.control.horizon.law import HorizonOptions
from feasigrasp.models.control.horizon.program import ProgramOptions
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions

__all__ = ["HorizonOptions", "ProgramOptions", "Safety", "SafetyFilter", "SafetyOptions"]

#: The former name of `SafetyFilter`, until the next release.
Safety = SafetyFilter
