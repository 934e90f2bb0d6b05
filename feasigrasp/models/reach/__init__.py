"""Reachability of the arm, at present and over the prediction horizon."""

from feasigrasp.models.reach.predicted_reachability import judge_grasps
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict

__all__ = [
    "VERDICTS",
    "Reachability",
    "Verdict",
    "judge_grasps",
]
