"""``feasigrasp bench kinematics``: time the arm's kinematics beside its peers.

Everything is timed in one go on one thread; `DIR/timings.csv` has all timings.
"""

import argparse
from collections.abc import Iterator

import numpy as np

from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp_lab.arm import in_collision
from feasigrasp_lab.paper.ik_flow import load_ik_flow
from feasigrasp_lab.peers import DrakeArm
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.timing import Case, report_bench, time_cases


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_kinematics", objects="builtin")


def cases(seed: int) -> Iterator[Case]:
    """What is timed, on random configurations, uniform inside the joint limits."""
    # Configurations whose self-collision is tested in one call; others have batches of 100.
    Q = IIWA_7.random_positions(np.random.default_rng(seed), 4096)
    batch = Q[:100].copy()
    X_WF = forward_kinematics(batch)
    reachability = Reachability(
        n_arm_angles=16, limit_margin=0.0, clearance=0.0, table_height=-10.0
    )
    X_WG = X_WF @ reachability.gripper.X_FG
    drake, flow = DrakeArm(), load_ik_flow()
    forward, collision = "bench.fk_jacobian_us.100", "bench.self_collision_us"
    yield Case(forward, "default", lambda: pose_and_jacobian(batch))
    yield Case(forward, "peer:drake", lambda: drake.pose_and_jacobian(batch))
    yield Case(collision, "default", lambda: in_collision(Q), len(Q))
    yield Case(collision, "peer:drake", lambda: drake.in_collision(Q), len(Q))
    inverse = "bench.ik_100x16_ms"
    yield Case(inverse, "default", lambda: reachability.nearest(X_WG, IIWA_7.home))
    yield Case("bench.ik_flow_ms.100", "default", lambda: flow.solve(X_WF))


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    rows = time_cases(cases(args.seed), 0.2 if args.quick else 2.0)
    report_bench(args, "kinematics", rows)
    return 0
