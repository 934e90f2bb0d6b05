"""What the arm can reach, now and soon."""

from feasigrasp.models.reach.predicted_reachability import judge_grasps
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict

__all__ = [
    "VERDICTS",
    "Reachability",
    "Verdict",
    "judge_grasps",
]
