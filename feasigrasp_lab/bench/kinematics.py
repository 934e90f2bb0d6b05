"""``feasigrasp bench kinematics``: time the arm's kinematics beside its peers.

Everything is timed in one go on one thread, so that what is compared ran under the same
conditions; nothing is taken over from an earlier run. `DIR/timings.csv` has all timings.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from importlib import import_module

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_and_jacobian
from feasigrasp.models.weights_file import WeightsError
from feasigrasp_lab.arm.self_collision import IIWA_CAPSULES, in_collision, in_collision_kernel
from feasigrasp_lab.measures.timing import Case, installed, report_bench, time_cases
from feasigrasp_lab.paper.ik_flow import IkFlow
from feasigrasp_lab.peers.drake_arm import DrakeArm
from feasigrasp_lab.results.arguments import add_common_arguments


def pinocchio_kinematics() -> Callable[[Array], tuple[Array, Array]]:
    """Flange poses and Jacobians (rows [linear; angular]) of configurations (n, 7), one by one.

    Raises:
        ImportError: pinocchio (PyPI: pin) is not installed.
    """
    pin = import_module("pinocchio")
    model, joint = pin.Model(), 0
    *steps, last = (pin.SE3(np.eye(3), np.array([0.0, 0.0, z])) for z in IIWA_7.link_steps)
    for name, step, axis in zip(IIWA_7.joint_names, steps, IIWA_7.axes, strict=True):
        kind = pin.JointModelRZ() if axis[2] else pin.JointModelRevoluteUnaligned(axis)
        joint = model.addJoint(joint, kind, step, name)
    flange = model.addFrame(pin.Frame("flange", joint, 0, last, pin.FrameType.OP_FRAME))
    data = model.createData()

    def run(Q: Array) -> tuple[Array, Array]:
        X_WF, J_WF = np.empty((len(Q), 4, 4)), np.empty((len(Q), 6, IIWA_7.joints))
        for k, q in enumerate(Q):
            J_WF[k] = pin.computeFrameJacobian(model, data, q, flange, pin.LOCAL_WORLD_ALIGNED)
            X_WF[k] = pin.updateFramePlacement(model, data, flange).homogeneous
        return X_WF, J_WF

    return run


#: Configurations whose self-collision is tested in one call. Source: guessed.
COLLISION_BATCH = 4096

_FK, _COLLISION = "bench.fk_jacobian_us.100", "bench.self_collision_us"
_INVERSE = "bench.ik_100x16_ms"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_kinematics", objects="builtin")


@compiled
def _one_by_one(Q, model, hit):
    """What batches are measured against."""
    for k in range(len(Q)):
        hit[k] = in_collision_kernel(Q[k], model, 0.0)


def cases(seed: int) -> Iterator[Case]:
    """What is timed.

    Args:
        seed: Seed of the random configurations, uniform inside the joint limits.
    """
    # Configurations and poses of a batch, arm angles tried for each pose.
    count, arm_angles = 100, 16
    rng = np.random.default_rng(seed)
    Q = IIWA_7.random_positions(rng, COLLISION_BATCH)
    batch = Q[:count].copy()
    X_WF = forward_kinematics(batch)
    reachability = Reachability(
        n_arm_angles=arm_angles, limit_margin=0.0, clearance=0.0, table_height=-10.0
    )
    X_WG = X_WF @ reachability.gripper.X_FG
    drake = DrakeArm()
    hit = np.empty(len(Q), dtype=bool)
    yield Case(_FK, "default", lambda: pose_and_jacobian(batch))
    # The peers have no batches: this is what compares with them call by call.
    yield Case(_FK, "one by one", lambda: [pose_and_jacobian(q) for q in batch])
    yield Case(_FK, "peer:drake", lambda: drake.pose_and_jacobian(batch))
    yield Case(_COLLISION, "default", lambda: in_collision(Q), len(Q))
    yield Case(_COLLISION, "one by one", lambda: _one_by_one(Q, IIWA_CAPSULES, hit), len(Q))
    yield Case(_COLLISION, "peer:drake", lambda: drake.in_collision(Q), len(Q))
    yield Case(_INVERSE, "default", lambda: reachability.nearest(X_WG, IIWA_7.home))
    yield Case(_INVERSE, "one by one", lambda: [reachability.nearest(X, IIWA_7.home) for X in X_WG])
    if installed("pinocchio", "pinocchio (PyPI: pin)"):
        pinocchio = pinocchio_kinematics()
        yield Case(_FK, "peer:pinocchio", lambda: pinocchio(batch))
    try:
        flow = IkFlow.load_default()
        yield Case("bench.ik_flow_ms.100", "default", lambda: flow.solve(X_WF))
    except WeightsError as error:
        print(f"bench.ik_flow_ms.100 is left out: {error}")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    rows = time_cases(cases(args.seed), 0.2 if args.quick else 2.0)
    report_bench(args, "kinematics", rows)
    return 0
