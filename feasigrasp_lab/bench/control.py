"""``feasigrasp bench control``: time the controllers beside the paper's Table III.

What is timed is a whole evaluation of a controller's output, by Drake, after its joint positions
and the object's pose have changed; on one thread. `DIR/timings.csv` has all timings.

- ``bench.task_hz.K``: task space, corrected mode, mixture of K components.
- ``bench.joint_hz.N``: joint space, corrected mode; the inverse kinematics of N solutions at the
  new pose, the fit of the field to them and its gradient, at every step. Preset ``new solutions``:
  the solutions are also looked for anew at every step.
- ``bench.planning_ms.median|p99|worst``: the update at 10 Hz in between, safe mode, in which the
  controller chooses anew what to follow; with the sizes of the next line.
- ``bench.task_safe_hz.8``, ``bench.joint_safe_hz.64``: safe mode, limits and clearances enforced.
- Presets ``peer:numpy`` and ``peer:torch``: the paper's step as plain array code, for joint space
  with damped least squares in place of the paper's network.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import torch
from threadpoolctl import threadpool_limits

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.joint.law import JointControlOptions
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.runs.results.arguments import add_common_arguments
from feasigrasp.runs.results.rows import Row, format_rows
from feasigrasp.systems.gp_joint_controller import GPJointController
from feasigrasp.systems.rmm_task_controller import RMMTaskController
from feasigrasp_lab.measures.timing import Case, report_bench, time_cases
from feasigrasp_lab.peers.control import ArrayJointStep, ArrayTaskStep
from feasigrasp_lab.report.paper_tables import TABLE_3_JOINT, TABLE_3_TASK
from feasigrasp_lab.runs.controller_probe import V_WO, ControllerProbe, grasps_in_reach

#: Components of the safe task controller, solutions of the safe joint controller.
SAFE_COMPONENTS, SAFE_SOLUTIONS = 8, 64
#: Groups of the grasps that the joint controller gets.
_GROUPS = 10
#: Grasps in each component, and how many draws may fail to give as many components as wanted.
_PER_GROUP, _DRAWS = 12, 20
#: Sizes that the peers are timed with.
_PEERS_TASK, _PEERS_JOINT = (1, 10), (10, 100)
#: Time between updates of the controllers [s].
_PLANNING = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_common_arguments(parser, out="out/bench_control", objects="builtin")


def main(args: argparse.Namespace) -> int:
    """Runs the command."""
    torch.set_num_threads(1)
    rows = time_cases(cases(args.seed), 0.1 if args.quick else 2.0)
    with threadpool_limits(1):
        rows += planning_rows(args.seed, 60 if args.quick else 1000)
    report_bench(args, "control", rows, f"{format_rows(rows)}\n{format_table_3(rows)}")
    return 0


def cases(seed: int) -> Iterator[Case]:
    """Everything that is timed.

    Args:
        seed: Seed of the grasps and of the inputs that follow one another.
    """
    reachability = Reachability()
    X_FG = reachability.gripper.X_FG
    for K in TABLE_3_TASK:
        name, probe = f"bench.task_hz.{K}", task_probe(reachability, K, "corrected", seed)
        yield Case(name, "default", probe.step)
        if K in _PEERS_TASK:
            mixture = probe.controller.memory(probe.context).mixture.targets
            for xp in (np, torch):
                step = partial(_fed, ArrayTaskStep(xp, mixture, X_FG), probe, V_WO)
                yield Case(name, f"peer:{xp.__name__}", step)
    for N in TABLE_3_JOINT:
        name, probe = f"bench.joint_hz.{N}", joint_probe(reachability, N, "corrected", seed)
        yield Case(name, "default", probe.step)
        if N in _PEERS_JOINT:
            renewed = joint_probe(reachability, N, "corrected", seed, period=_STEP)
            yield Case(name, "new solutions", partial(_renewed_step, renewed))
            X_OG = probe.controller.memory(probe.context).X_OG
            for xp in (np, torch):
                step = partial(_fed, ArrayJointStep(xp, X_OG, X_FG), probe)
                yield Case(name, f"peer:{xp.__name__}", step)
    safe = task_probe(reachability, SAFE_COMPONENTS, "safe", seed)
    yield Case(f"bench.task_safe_hz.{SAFE_COMPONENTS}", "default", safe.step)
    safe = joint_probe(reachability, SAFE_SOLUTIONS, "safe", seed)
    yield Case(f"bench.joint_safe_hz.{SAFE_SOLUTIONS}", "default", safe.step)


def planning_rows(seed: int, count: int) -> list[Row]:
    """How long the controllers plan: median, 99th percentile and worst of many updates."""
    reachability, rows = Reachability(), []
    for preset, probe in (
        ("task/safe", task_probe(reachability, SAFE_COMPONENTS, "safe", seed)),
        ("joint/safe", joint_probe(reachability, SAFE_SOLUTIONS, "safe", seed, period=_PLANNING)),
    ):
        times = probe.update_ms(_PLANNING, count)
        for name, value in (
            ("median", np.median(times)),
            ("p99", np.percentile(times, 99)),
            ("worst", times.max()),
        ):
            rows.append(Row.plain(f"bench.planning_ms.{name}", preset, value, "ms", count))
    return rows


def task_probe(reachability: Reachability, K: int, mode: str, seed: int) -> ControllerProbe:
    """A task-space controller whose mixture has K components.

    Raises:
        RuntimeError: No draw of grasps gives that many.
    """
    for draw in range(_DRAWS):
        rng = np.random.default_rng([seed, draw])
        grasps = grasps_in_reach(reachability, K, _PER_GROUP, rng)
        controller = RMMTaskController(reachability, max_components=K, mode=mode)
        probe = ControllerProbe(controller, grasps, rng)
        mixture = controller.memory(probe.context).mixture
        if mixture is not None and len(mixture.mixture) == K:
            return probe
    raise RuntimeError(f"{_DRAWS} draws of {K} groups of grasps gave no mixture of {K} components")


def joint_probe(
    reachability: Reachability, N: int, mode: str, seed: int, *, period: float = 0.05
) -> ControllerProbe:
    """A joint-space controller that follows N solutions.

    Raises:
        RuntimeError: It found fewer.
    """
    rng = np.random.default_rng(seed)
    grasps = grasps_in_reach(reachability, _GROUPS, -(-N // _GROUPS), rng)
    grasps = grasps.select(np.arange(N))
    controller = GPJointController(
        reachability,
        JointControlOptions(solutions=SolutionOptions(n_solutions=N)),
        period=period,
        mode=mode,
    )
    probe = ControllerProbe(controller, grasps, rng)
    found = len(controller.memory(probe.context))
    if found != N:
        raise RuntimeError(f"the controller follows {found} solutions of {len(grasps)} grasps")
    return probe


#: Simulated time between steps that look for new solutions [s].
_STEP = 0.01


def _renewed_step(probe: ControllerProbe) -> Array:
    """A step with the update before it in which the controller looks for solutions."""
    probe.simulator.AdvanceTo(probe.context.get_time() + _STEP)
    return probe.step()


def _fed(step: Callable[..., object], probe: ControllerProbe, *more: Array) -> object:
    """A peer's step with the next inputs of a probe."""
    q, pose = probe.next_inputs()
    return step(q, pose.GetAsMatrix4(), *more)


def format_table_3(rows: list[Row]) -> str:
    """Our figures beside the paper's, one line per size."""
    found = {(row.name, row.preset): row.value for row in rows}
    heads = f"{'':18s}{'paper Hz':>10s}{'ours Hz':>10s}{'times':>8s}"
    lines = [f"{heads}{'new sol.':>10s}{'numpy':>9s}{'torch':>9s}"]
    for space, letter, table in (("task", "K", TABLE_3_TASK), ("joint", "N", TABLE_3_JOINT)):
        for size, paper in table.items():
            name = f"bench.{space}_hz.{size}"
            ours = found[name, "default"]
            line = f"{space:6s}{letter} = {size:<7d}{paper:10.1f}{ours:10.0f}{ours / paper:8.0f}"
            presets = (("new solutions", 10), ("peer:numpy", 9), ("peer:torch", 9))
            more = [(found.get((name, preset)), width) for preset, width in presets]
            cells = ["" if hz is None else f"{hz:.0f}" for hz, _ in more]
            lines.append(
                line + "".join(f"{c:>{w}s}" for c, (_, w) in zip(cells, more, strict=True))
            )
    return "\n".join(lines)
