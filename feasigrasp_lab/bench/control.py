"""``feasigrasp bench control``: time the controllers beside the paper's Table III.

What is timed is a whole evaluation of a controller's output, by Drake, after its joint positions
and the object's pose have changed; on one thread. `DIR/timings.csv` has all timings.

- ``bench.task_hz.K``: task space, corrected mode, mixture of K components.
- ``bench.joint_hz.N``: joint space, corrected mode; the inverse kinematics of N solutions at the
  new pose, the fit of the field to them and its gradient, at every step.
- ``bench.planning_ms.median|p99|worst``: the update in between, safe mode: a step of the optimal
  control problem, and ten times a second the ranking of the grasps, those of the next line.
- ``bench.task_safe_hz.8``, ``bench.joint_safe_hz.64``: safe mode, limits and clearances enforced;
  of 8 groups of grasps, and of 64 grasps.
- Presets ``peer:numpy`` and ``peer:torch``: the paper's step as plain array code, for joint space
  with damped least squares in place of the paper's network.
"""

import argparse
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle

import numpy as np
import torch
from pydrake.math import RigidTransform
from pydrake.multibody.math import SpatialVelocity
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import LeafSystem
from threadpoolctl import threadpool_limits

from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import ControlSpace
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm_file import arm_names, load_arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics
from feasigrasp.systems.horizon_controller import GPJointController, RMMTaskController
from feasigrasp_lab.paper.modes import PaperJointController, PaperTaskController
from feasigrasp_lab.paper.options import PaperOptions
from feasigrasp_lab.peers import ArrayJointStep, ArrayTaskStep
from feasigrasp_lab.report.paper_tables import TABLE_3_JOINT, TABLE_3_TASK
from feasigrasp_lab.results.arguments import add_common_arguments
from feasigrasp_lab.results.rows import Row
from feasigrasp_lab.results.timing import Case, report_bench, time_cases

#: Where the object is, and its twist [angular; linear]. Source: guessed.
X_WO = se3.make_pose(se3.so3_exp([0.2, -0.1, 0.4]), [0.5, 0.0, 0.5])
V_WO = np.array([0.1, 0.0, 0.2, 0.1, 0.0, 0.0])


def grasps_in_reach(
    reachability: Reachability, n_groups: int, per_group: int, rng: np.random.Generator
) -> GraspSet:
    """Groups of grasps that the arm reaches.

    Args:
        reachability: Test of poses.
        n_groups: Number of groups; they are well apart in orientation and position.
        per_group: Grasps in each, which differ by some millimetres and degrees.
        rng: Draws them.
    """
    # Groups are this far apart, in radians and tenths of a metre.
    apart, units = 1.0, np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
    X_FG, arm, home = reachability.gripper.X_FG, reachability.arm, reachability.arm.home
    centers: list[Array] = []
    groups: list[Array] = []
    while len(groups) < n_groups:
        center = forward_kinematics(home + rng.uniform(-0.9, 0.9, len(home)), X_FG, arm)
        gaps = [se3.log(se3.inverse(center) @ other) for other in centers]
        if any(np.linalg.norm(gap * units) < apart for gap in gaps):
            continue
        spread = rng.normal(0.0, 1.0, (2 * per_group, 6)) * ([0.03] * 3 + [0.003] * 3)
        X_WG = center @ se3.exp(spread)
        X_WG = X_WG[reachability.reachable(X_WG)][:per_group]
        if len(X_WG) == per_group:
            centers.append(center)
            groups.append(X_WG)
    X_OG = se3.inverse(X_WO) @ np.concatenate(groups)
    return GraspSet(X_OG, np.full(len(X_OG), 0.05), rng.uniform(0.5, 1.0, len(X_OG)))


class ControllerProbe:
    """A controller after its first update, and inputs to evaluate its output with."""

    def __init__(
        self,
        controller: LeafSystem,
        grasps: GraspSet,
        rng: np.random.Generator,
        home: Array = IIWA_7.home,
    ) -> None:
        """Fixes the inputs of a controller and lets it take up the grasps."""
        # Different inputs that follow one another.
        inputs = 64
        self.controller = controller
        self.simulator = Simulator(controller)
        self.context = self.simulator.get_mutable_context()
        fixed = {
            name: controller.GetInputPort(name).FixValue(self.context, value)
            for name, value in {
                "position": home,
                "grasps": grasps,
                "object_pose": RigidTransform(X_WO),
                "object_velocity": SpatialVelocity(V_WO),
                "desired_velocity": np.zeros(len(home)),
            }.items()
        }
        self.simulator.Initialize()
        self.simulator.AdvanceTo(1e-3)
        self._output = controller.GetOutputPort("commanded_velocity")
        self._position, self._pose = fixed["position"], fixed["object_pose"]
        self._grasps = fixed["grasps"]
        few = rng.permutation(len(grasps))[: max(1, 4 * len(grasps) // 5)]
        self._views = cycle([grasps.select(np.sort(few)), grasps])
        poses = X_WO @ se3.exp(rng.normal(0.0, 0.01, (inputs, 6)))
        positions = home + rng.normal(0.0, 0.05, (inputs, len(home)))
        self.inputs = list(zip(positions, map(RigidTransform, poses), strict=True))
        self._next = cycle(self.inputs)

    def next_inputs(self) -> tuple[Array, RigidTransform]:
        """Joint positions (7,) and object pose that have not just been used."""
        return next(self._next)

    def step(self) -> Array:
        """The command for the next inputs, shape (7,)."""
        self._move_on()
        command: Array = self._output.Eval(self.context)
        return command

    def update_ms(self, period: float, count: int) -> Array:
        """Processor time of updates that follow one another [ms], shape (count,).

        Arm and object are elsewhere at every update, and grasps are others twice in a second.

        Args:
            period: Time between updates of the controller [s].
            count: Number of updates.
        """
        # Updates that are not timed, since the first ones load compiled code.
        warm_up = 15
        view, times = round(0.5 / period), []
        for k in range(warm_up + count):
            self._move_on()
            if k % view == 0:
                self._grasps.GetMutableData().set_value(next(self._views))
            start = time.process_time()
            self.simulator.AdvanceTo(self.context.get_time() + period)
            times.append(1e3 * (time.process_time() - start))
        return np.array(times[warm_up:])

    def _move_on(self) -> None:
        q, pose = self.next_inputs()
        self._position.GetMutableData().set_value(q)
        self._pose.GetMutableData().set_value(pose)


#: Groups of grasps of the safe task controller, grasps of the safe joint controller. Source:
#: guessed.
_SAFE_SIZES = {ControlSpace.TASK: 8, ControlSpace.JOINT: 64}
#: Grasps in each group, and how many draws may fail to give as many components as wanted. Source:
#: guessed.
_PER_GROUP, _DRAWS = 12, 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_control", objects="builtin")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    torch.set_num_threads(1)
    rows = time_cases(cases(args.seed), 0.1 if args.quick else 2.0)
    with threadpool_limits(1):
        rows += planning_rows(args.seed, 60 if args.quick else 1000)
    report_bench(args, "control", rows)
    return 0


def cases(seed: int) -> Iterator[Case]:
    """Everything that is timed; the seed is that of the grasps and of the inputs."""
    # Sizes that the peers are timed with.
    peers_task, peers_joint = (1, 10), (10, 100)
    reachability = Reachability()
    X_FG = reachability.gripper.X_FG
    for K in TABLE_3_TASK:
        name, probe = f"bench.task_hz.{K}", task_probe(reachability, K, seed)
        yield Case(name, "default", probe.step)
        if K in peers_task:
            mixture = probe.controller.memory(probe.context).mixture.targets
            for xp in (np, torch):
                step = partial(_fed, ArrayTaskStep(xp, mixture, X_FG), probe, V_WO)
                yield Case(name, f"peer:{xp.__name__}", step)
    for N in TABLE_3_JOINT:
        name, probe = f"bench.joint_hz.{N}", joint_probe(reachability, N, seed)
        yield Case(name, "default", probe.step)
        if N in peers_joint:
            X_OG = probe.controller.memory(probe.context).X_OG
            for xp in (np, torch):
                step = partial(_fed, ArrayJointStep(xp, X_OG, X_FG), probe)
                yield Case(name, f"peer:{xp.__name__}", step)
    for space, size in _SAFE_SIZES.items():
        safe = safe_probe(reachability, space, seed)
        yield Case(f"bench.{space}_safe_hz.{size}", "default", safe.step)


def planning_rows(seed: int, count: int) -> list[Row]:
    """How long the controllers plan: median, 99th percentile and worst of many updates.

    Of other arms than the iiwa 7 in task space, where an update costs as much.
    """
    rows, others = [], [name for name in arm_names() if name != "iiwa7"]
    probed = [(space, "iiwa7") for space in ControlSpace]
    for space, arm in probed + [(ControlSpace.TASK, name) for name in others]:
        probe = safe_probe(Reachability(arm=load_arm(arm)), space, seed)
        times = probe.update_ms(probe.controller.period, count)
        preset = f"{space}/safe" if arm == "iiwa7" else f"{space}/safe/{arm}"
        for name, value in (
            ("median", np.median(times)),
            ("p99", np.percentile(times, 99)),
            ("worst", times.max()),
        ):
            rows.append(Row.plain(f"bench.planning_ms.{name}", preset, value, "ms", count))
    return rows


def safe_probe(reachability: Reachability, space: ControlSpace, seed: int) -> ControllerProbe:
    """The controller of a space in safe mode, among many grasps."""
    rng, size, home = np.random.default_rng(seed), _SAFE_SIZES[space], reachability.arm.home
    if space == ControlSpace.TASK:
        grasps = grasps_in_reach(reachability, size, _PER_GROUP, rng)
        return ControllerProbe(RMMTaskController(reachability), grasps, rng, home)
    some = _some(reachability, size, rng)
    return ControllerProbe(GPJointController(reachability), some, rng, home)


def _some(reachability: Reachability, N: int, rng: np.random.Generator) -> GraspSet:
    """N grasps in ten groups."""
    return grasps_in_reach(reachability, 10, -(-N // 10), rng).select(np.arange(N))


def task_probe(reachability: Reachability, K: int, seed: int) -> ControllerProbe:
    """A task-space controller, corrected mode, whose mixture has K components.

    Raises:
        RuntimeError: No draw of grasps gives that many.
    """
    for draw in range(_DRAWS):
        rng = np.random.default_rng([seed, draw])
        grasps = grasps_in_reach(reachability, K, _PER_GROUP, rng)
        controller = PaperTaskController(reachability, max_components=K)
        probe = ControllerProbe(controller, grasps, rng)
        mixture = controller.memory(probe.context).mixture
        if mixture is not None and len(mixture.mixture) == K:
            return probe
    raise RuntimeError(f"{_DRAWS} draws of {K} groups of grasps gave no mixture of {K} components")


def joint_probe(reachability: Reachability, N: int, seed: int) -> ControllerProbe:
    """A joint-space controller, corrected mode, that follows N solutions.

    Raises:
        RuntimeError: It found fewer.
    """
    rng, options = np.random.default_rng(seed), PaperOptions(n_solutions=N)
    grasps = _some(reachability, N, rng)
    controller = PaperJointController(reachability, options, period=0.05)
    probe = ControllerProbe(controller, grasps, rng)
    found = len(controller.memory(probe.context))
    if found != N:
        raise RuntimeError(f"the controller follows {found} solutions of {len(grasps)} grasps")
    return probe


def _fed(step: Callable[..., object], probe: ControllerProbe, *more: Array) -> object:
    """A peer's step with the next inputs of a probe."""
    q, pose = probe.next_inputs()
    return step(q, pose.GetAsMatrix4(), *more)
