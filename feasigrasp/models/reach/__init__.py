"""What the arm can reach, now and soon."""

from feasigrasp.models.reach.lookahead import judge_grasps
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.reach.reachable_space import ReachableSpace

__all__ = ["Reachability", "ReachableSpace", "judge_grasps"]
