"""Reachability of the arm, at present and over the prediction horizon."""

from feasigrasp.models.reach.feasible_grasps import feasible_grasps, feasible_poses
from feasigrasp.models.reach.interception import InterceptionOptions, Situation, find_interceptions
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict

__all__ = [
    "VERDICTS",
    "InterceptionOptions",
    "Reachability",
    "Situation",
    "Verdict",
    "find_interceptions",
    "feasible_grasps",
    "feasible_poses",
]
