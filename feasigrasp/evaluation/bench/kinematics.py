"""``feasigrasp bench kinematics``: how quick the arm's kinematics are, beside its peers.

Everything is timed in one go on one thread, so that what is compared ran under the same
conditions; nothing is taken over from an earlier run. `DIR/timings.csv` has all timings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from importlib.util import find_spec

import numpy as np
from numba import njit
from threadpoolctl import threadpool_limits
from tqdm import tqdm

from feasigrasp.evaluation.bench.report import report_bench, timing_row
from feasigrasp.evaluation.bench.timing import cpu_time
from feasigrasp.evaluation.peers.drake_arm import DrakeArm
from feasigrasp.evaluation.peers.kinematics import eaik_nearest, pinocchio_kinematics
from feasigrasp.models.ik.flow import IkFlow, WeightsError
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.collision_kernels import in_collision_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.robot.self_collision import IIWA_CAPSULES, in_collision
from feasigrasp.results.arguments import add_common_arguments

#: Configurations and poses of a batch, arm angles tried for each pose.
BATCH, ARM_ANGLES = 100, 16
#: Configurations whose self-collision is tested in one call.
COLLISION_BATCH = 4096
#: From where the nearest solution is looked for [rad].
HOME = np.array([0.0, -0.846, 0.0, -1.582, 0.0, 1.446, 0.0])

_ROW_NAMES = ("bench.fk_jacobian_us.100", "bench.self_collision_us", "bench.ik_100x16_ms")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_kinematics", objects="builtin")


@njit(cache=True)
def _one_by_one(Q, model, hit):
    """What batches are measured against."""
    for k in range(len(Q)):
        hit[k] = in_collision_kernel(Q[k], model, 0.0)


def cases(seed: int) -> list[tuple[str, str, str, float, Callable[[], object]]]:
    """What is timed: row name, preset, unit, factor from seconds per call, function.

    Args:
        seed: Seed of the random configurations, uniform inside the joint limits.
    """
    rng = np.random.default_rng(seed)
    Q = IIWA_7.random_positions(rng, COLLISION_BATCH)
    batch = Q[:BATCH].copy()
    X_WF = forward_kinematics(batch)
    reach = Reachability(n_arm_angles=ARM_ANGLES)
    X_WG = X_WF @ reach.gripper.X_FG
    drake = DrakeArm()
    fk, collision, inverse = _ROW_NAMES
    hit, per_configuration = np.empty(len(Q), dtype=bool), 1e6 / len(Q)
    found: list[tuple[str, str, str, float, Callable[[], object]]] = [
        (fk, "default", "us", 1e6, lambda: pose_and_jacobian(batch)),
        (fk, "peer:drake", "us", 1e6, lambda: drake.pose_and_jacobian(batch)),
        (collision, "default", "us", per_configuration, lambda: in_collision(Q)),
        (
            collision,
            "one by one",
            "us",
            per_configuration,
            lambda: _one_by_one(Q, IIWA_CAPSULES, hit),
        ),
        (collision, "peer:drake", "us", per_configuration, lambda: drake.in_collision(Q)),
        (inverse, "default", "ms", 1e3, lambda: reach.nearest(X_WG, HOME)),
    ]
    if find_spec("pinocchio"):
        pinocchio = pinocchio_kinematics()
        found.append((fk, "peer:pinocchio", "us", 1e6, lambda: pinocchio(batch)))
    else:
        print("pinocchio is not installed (PyPI: pin): its row is left out")
    if find_spec("eaik"):
        eaik = eaik_nearest(
            np.linspace(-IIWA_7.position_limits[2], IIWA_7.position_limits[2], ARM_ANGLES)
        )
        found.append((inverse, "peer:eaik", "ms", 1e3, lambda: eaik(X_WF, HOME)))
    else:
        print("EAIK is not installed (PyPI: eaik): its row is left out")
    try:
        flow = IkFlow.load_default()
        found.append(("bench.ik_flow_ms.100", "default", "ms", 1e3, lambda: flow.solve(X_WF)))
    except WeightsError as error:
        print(f"bench.ik_flow_ms.100 is left out: {error}")
    return found


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    rows = []
    with threadpool_limits(1):
        for name, preset, unit, factor, function in tqdm(cases(args.seed), desc="kinematics"):
            timing = cpu_time(function, 0.2 if args.quick else 2.0)
            rows.append(timing_row(name, preset, timing, unit, factor))
    report_bench(args, "kinematics", rows)
    return 0
