"""What the arm can reach, now and soon."""

from feasigrasp.models.reach.judge import JudgeMethod, PoseJudge
from feasigrasp.models.reach.lookahead import judge_grasps
from feasigrasp.models.reach.reachability import VERDICTS, Reachability, Verdict
from feasigrasp.models.reach.reachable_space import ReachableSpace

__all__ = [
    "VERDICTS",
    "JudgeMethod",
    "PoseJudge",
    "Reachability",
    "ReachableSpace",
    "Verdict",
    "judge_grasps",
]
