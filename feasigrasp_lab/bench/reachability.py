"""``feasigrasp bench reachability``: time the reachability filter and its fit.

Timed on one thread unless a preset says otherwise; nothing is taken over from an earlier run.
`DIR/timings.csv` has all timings.

- ``bench.reachability_filter_ms.rmm|ik|both``: 1024 random hand poses about an object half a metre
  in front of the arm are judged (``default``); and the whole filter on 1024 grasps with their flips
  on an object that moves (``whole filter``): of ``ik`` their interceptions, of the others, the
  paper's, a judgement 1 s ahead, none left out as worse than others.
- ``bench.em_pass_s``: one pass of expectation maximisation.
"""

from __future__ import annotations

import argparse
import time
from functools import partial

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.feasible_grasps import feasible_grasps
from feasigrasp.models.reach.interception import InterceptionOptions, Situation
from feasigrasp.models.reach.reachability import REACHABLE, Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.measures.timing import (
    Case,
    Timing,
    report_bench,
    time_cases,
    timing_row,
)
from feasigrasp_lab.paper.judge import JudgeMethod, PoseJudge
from feasigrasp_lab.paper.predicted_reachability import KeepingRule, judge_grasps
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.training.reachability.fit_mixture import LargeFit, em_pass, fit_large_mixture
from feasigrasp_lab.training.reachability.pose_blocks import PoseBlocks
from feasigrasp_lab.training.reachability.reachable_poses import IiwaArm, sample_reachable_poses

#: Grasps of a case, components of the mixture, and poses that it is fitted to. Source: guessed.
GRASPS, COMPONENTS, POSES = 1024, 64, 3_000_000
#: The object: pose and twist [angular; linear]. Source: guessed.
X_WO = se3.make_pose(np.eye(3), [0.5, 0.0, 0.5])
V_WO = np.array([0.0, 0.0, 0.2, 0.05, 0.05, 0.0])


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_reachability", objects="builtin")


def random_grasps(seed: int) -> GraspSet:
    """The grasps that the filters get; about half of them can be reached."""
    # Grasps have any orientation and are this far from the object's centre at most, per axis [m].
    object_size = 0.05
    rng = np.random.default_rng(seed)
    X_OG = se3.random_pose(rng, GRASPS)
    X_OG[:, :3, 3] = rng.uniform(-object_size, object_size, (GRASPS, 3))
    return GraspSet(X_OG, np.full(GRASPS, 0.05), rng.random(GRASPS))


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    seconds = 0.2 if args.quick else 2.0
    grasps = random_grasps(args.seed)
    reachable = np.mean(Reachability().verdicts(X_WO @ grasps.X_OG) == REACHABLE)
    with threadpool_limits(1):
        rows = _filter_rows(grasps, seconds) + _em_rows(args.seed, args.quick)
    print(f"{reachable:.0%} of the {GRASPS} hand poses are reachable")
    report_bench(args, "reachability", rows, reachable_share=float(reachable))
    return 0


def _filter_rows(grasps: GraspSet, seconds: float) -> list[Row]:
    reachability, X_WG = Reachability(), X_WO @ grasps.X_OG
    now = Situation(0.0, IIWA_7.home, np.zeros(IIWA_7.joints), X_WO, V_WO)
    rule = KeepingRule(n_best=2 * GRASPS, score_share=0.0)
    cases: list[Case] = []
    for method in (JudgeMethod.IK, JudgeMethod.RMM, JudgeMethod.BOTH):
        judge, name = PoseJudge(reachability, method), f"bench.reachability_filter_ms.{method}"
        whole = partial(judge_grasps, grasps, X_WO, V_WO, judge, rule=rule)
        if method == JudgeMethod.IK:
            whole = partial(feasible_grasps, grasps, now, reachability, InterceptionOptions())
        cases.append(Case(name, "default", partial(judge.verdicts, X_WG)))
        cases.append(Case(name, "whole filter", whole))
    return time_cases(cases, seconds)


def _em_rows(seed: int, quick: bool) -> list[Row]:
    rng = np.random.default_rng(seed)
    n = POSES // 10 if quick else POSES
    quaternions, positions = _reached(n, rng)
    poses = PoseBlocks.of(quaternions, positions)
    start = LargeFit(max_iterations=10)
    mixture, _ = fit_large_mixture(poses.subset(rng, 200_000), COMPONENTS, rng, start)
    size = f", N = {n:,}" if quick else ""
    rows = []
    for threads, preset in ((1, "default"), (2, "2 threads")):
        # Of one thread, processor time: it leaves out what other processes take away.
        clock = time.process_time if threads == 1 else time.perf_counter
        times = []
        for _ in tqdm(range(6 if quick else 8), desc=f"EM pass, {threads} threads"):
            begin = clock()
            em_pass(poses, mixture, threads)
            times.append(clock() - begin)
        times = sorted(times[1:])
        timing = Timing(float(np.median(times)), times[0], times[-1], len(times))
        rows.append(timing_row("bench.em_pass_s", preset + size, timing))
    return rows


def _reached(n: int, rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Quaternions (n, 4) and positions (n, 3) of reached flange poses, single precision."""
    arm, parts = IiwaArm(), []
    with tqdm(total=n, desc="poses", unit_scale=True) as bar:
        while bar.n < n:
            parts.append(sample_reachable_poses(arm, 250_000, rng))
            bar.update(len(parts[-1].positions))
    quaternions = np.concatenate([part.quaternions for part in parts])[:n]
    return quaternions, np.concatenate([part.positions for part in parts])[:n]
