"""``feasigrasp bench reachability``: time the reachability filter.

On one thread; nothing is taken over from an earlier run. `DIR/timings.csv` has all timings.

- ``bench.reachability_filter_ms.rmm|ik|both``: 1024 random hand poses about an object half a metre
  in front of the arm are judged (``default``); and the whole filter on 1024 grasps with their flips
  on an object that moves (``whole filter``): of ``ik`` their interceptions, of the others, the
  paper's, a judgement 1 s ahead, none left out as worse than others.
"""

import argparse
from functools import partial
from typing import Any

import numpy as np

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.feasible_grasps import feasible_grasps
from feasigrasp.models.reach.interception import InterceptionOptions, Situation
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.paper.judge import JudgeMethod, PoseJudge
from feasigrasp_lab.paper.predicted_reachability import judge_grasps
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.timing import Case, report_bench, time_cases

#: Grasps of a case. Source: guessed.
GRASPS = 1024
#: The object: pose and twist [angular; linear]. Source: guessed.
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
V_WO = np.array([0.0, 0.0, 0.2, 0.05, 0.05, 0.0])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_reachability", objects="builtin")


def random_grasps(seed: int) -> GraspSet:
    """The grasps that the filters get; about half of them can be reached."""
    # Grasps have any orientation and are this far from the object's centre at most, per axis [m].
    rng, size = np.random.default_rng(seed), 0.05
    X_OG = se3.random_pose(rng, GRASPS)
    X_OG[:, :3, 3] = rng.uniform(-size, size, (GRASPS, 3))
    return GraspSet(X_OG, np.full(GRASPS, 0.05), rng.random(GRASPS))


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    seconds = 0.2 if args.quick else 2.0
    grasps = random_grasps(args.seed)
    reachable = np.mean(Reachability().verdicts(X_WO @ grasps.X_OG) == REACHABLE)
    rows = _filter_rows(grasps, seconds)
    print(f"{reachable:.0%} of the {GRASPS} hand poses are reachable")
    report_bench(args, "reachability", rows, reachable_share=float(reachable))
    return 0


def _filter_rows(grasps: GraspSet, seconds: float) -> list[Row]:
    reachability, X_WG = Reachability(), X_WO @ grasps.X_OG
    now = Situation(0.0, IIWA_7.home, np.zeros(IIWA_7.joints), X_WO, V_WO)
    every: dict[str, Any] = {"n_best": 2 * GRASPS, "score_share": 0.0}
    cases: list[Case] = []
    for method in (JudgeMethod.IK, JudgeMethod.RMM, JudgeMethod.BOTH):
        judge, name = PoseJudge(reachability, method), f"bench.reachability_filter_ms.{method}"
        whole = partial(judge_grasps, grasps, X_WO, V_WO, judge, **every)
        if method == JudgeMethod.IK:
            whole = partial(feasible_grasps, grasps, now, reachability, InterceptionOptions())
        cases.append(Case(name, "default", partial(judge.verdicts, X_WG)))
        cases.append(Case(name, "whole filter", whole))
    return time_cases(cases, seconds)
