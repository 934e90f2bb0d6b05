"""Receding-horizon control towards the grasp of a moving object that can be followed.

Ten times a second all grasps are ranked by their interceptions, and the best one is selected, with
hysteresis. Fifty times a second one step of the optimal control problem over the next second is
solved, about the plan before.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.control.planning.continuation import branch_kernel
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.objects.prediction import Motion, future_poses
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.horizon.cost import INSTANT, cost_kernel
from feasigrasp_lab.horizon.interception import (
    InterceptionOptions,
    Interceptions,
    find_interceptions,
)
from feasigrasp_lab.horizon.program import ProgramOptions, positions, solve_program

#: A grasp this close to the selected one is taken for it when grasps are sampled anew [m, rad].
#: Source: guessed.
_SAME_GRASP = np.array([0.012, 0.25])
#: Scores below this count as this. Source: guessed.
_LEAST_SCORE = 0.05


@dataclass(frozen=True)
class HorizonOptions:
    """Options of the law.

    Attributes:
        rank_period: Between rankings [s], the period of the grasps.
        score: What a factor e in score is worth [s]; the prototype's choice, as the next two.
        switch: What another grasp must save [s].
        patience: A grasp that is not offered any more is followed for this time [s].
        corridor: The way into a grasp.
        interception: What can be followed.
        program: Knots and weights.
    """

    rank_period: float = 0.1
    score: float = 0.3
    switch: float = 0.3
    patience: float = 0.5
    corridor: ApproachCorridor = field(default_factory=ApproachCorridor)
    interception: InterceptionOptions = field(default_factory=InterceptionOptions)
    program: ProgramOptions = field(default_factory=ProgramOptions)


@dataclass(frozen=True, eq=False)
class HorizonPlan(Frozen):
    """A plan, and the grasp that it leads to.

    Attributes:
        time: When it was made [s].
        v: Joint velocities at the knots, shape (N + 1, 7) [rad/s]; None before the first plan.
        X_OG: The selected grasp in O, shape (4, 4) [m]; None without one.
        branch: Its inverse-kinematics branch.
        psi: Its arm angle [rad].
        arrival: Interception time [s].
        q: Configuration then, shape (7,) [rad].
        v_arrival: Its velocity, shape (7,) [rad/s].
        ranked: When the grasps were ranked [s].
        seen: When the selected grasp was last offered [s].
    """

    time: float = -np.inf
    v: Array | None = None
    X_OG: Array | None = None
    branch: int = -1
    psi: float = 0.0
    arrival: float = 0.0
    q: Array = field(default_factory=lambda: np.zeros(IIWA_7.joints))
    v_arrival: Array = field(default_factory=lambda: np.zeros(IIWA_7.joints))
    ranked: float = -np.inf
    seen: float = -np.inf


@dataclass(frozen=True, eq=False)
class Situation:
    """Arm and object now.

    Attributes:
        time: Now [s].
        q: Joint positions [rad], shape (7,).
        v: Joint velocities [rad/s], shape (7,).
        X_WO: Object pose, shape (4, 4) [m].
        V_WO: Object twist [angular; linear], shape (6,).
        motion: Predicts the object.
    """

    time: float
    q: Array
    v: Array
    X_WO: Array
    V_WO: Array
    motion: Motion | None = None

    def future(self, ahead: Array) -> Array:
        """Predicted poses (k, 4, 4) of the object at times from now on [s]."""
        return np.ascontiguousarray(future_poses(self.motion, self.X_WO, self.V_WO, ahead))


def next_plan(
    before: HorizonPlan,
    now: Situation,
    grasps: GraspSet,
    reachability: Reachability,
    options: HorizonOptions,
    *,
    committed: bool = False,
) -> HorizonPlan:
    """The next plan; without a grasp if none can be intercepted, or the object is unknown.

    Args:
        before: The plan before.
        now: Arm and object.
        grasps: Grasps on offer, in O.
        reachability: Hand, limits and clearances.
        options: Weights and limits.
        committed: Whether the hand is closing, or has closed, on the first of the grasps.
    """
    if not (np.isfinite(now.X_WO).all() and np.isfinite(now.V_WO).all()):
        return replace(before, time=now.time, X_OG=None)
    if committed and len(grasps):
        plan = _committed(before, now, grasps.X_OG[0])
    else:
        plan = _selected(before, now, grasps, reachability, options)
    if plan.X_OG is None:
        return plan
    program, n = options.program, len(options.program.steps)
    times = program.times[1:]
    X, after = now.future(np.concatenate([times, times + INSTANT])).reshape(2, n, 4, 4)
    v = _shifted(before, now, program)
    H, g = np.empty((n, IIWA_7.joints, IIWA_7.joints)), np.empty((n, IIWA_7.joints))
    v_ref = np.empty((n, IIWA_7.joints))
    cost_kernel(
        *(positions(now.q, v, program), times, X, after),
        *(np.array(plan.X_OG), plan.branch, plan.psi, np.array(now.q), np.array(now.v)),
        *(plan.arrival - now.time, np.array(plan.q), np.array(plan.v_arrival)),
        *(options.corridor.parameters, reachability.gripper.X_FG, program.record, H, g, v_ref),
    )
    solved = solve_program(now.q, v, H, g, v_ref, program)
    if solved is None:  # brake
        solved = v[0] * np.linspace(1.0, 0.0, n + 1)[:, None]
    return replace(plan, v=solved)


def total_cost(found: Interceptions, score: Array, options: HorizonOptions) -> Array:
    """Costs of interceptions of grasps with scores (n,), shape (n,) [s]."""
    return np.asarray(found.cost - options.score * np.log(np.clip(score, _LEAST_SCORE, 1.0)))


def plan_velocity(plan: HorizonPlan, time: float, options: ProgramOptions) -> Array:
    """Joint velocity (7,) [rad/s] of a plan for the tick that begins at a time [s]."""
    if plan.X_OG is None or plan.v is None:
        return np.zeros(IIWA_7.joints)
    at = time - plan.time + options.safety.period
    return np.array([np.interp(at, options.times, column) for column in plan.v.T])


def _shifted(before: HorizonPlan, now: Situation, options: ProgramOptions) -> Array:
    """Velocities of the plan before at the knots from now on, the first those of the arm."""
    if before.v is None or before.X_OG is None:
        return np.vstack([now.v, np.zeros((len(options.steps), IIWA_7.joints))])
    at = options.times + now.time - before.time
    v = np.array([np.interp(at, options.times, column) for column in before.v.T]).T
    return np.vstack([now.v, np.clip(v[1:], -options.most_v, options.most_v)])


def _committed(before: HorizonPlan, now: Situation, X_OG: Array) -> HorizonPlan:
    """The plan before with the grasp that the hand closes on, in the present configuration."""
    plan = replace(before, time=now.time, arrival=now.time, X_OG=X_OG)
    if before.X_OG is not None and np.array_equal(X_OG, before.X_OG):
        return plan
    q = np.array(now.q)
    return replace(plan, branch=int(branch_kernel(q)), psi=float(arm_angle_kernel(q)), q=q)


def _selected(
    before: HorizonPlan,
    now: Situation,
    grasps: GraspSet,
    reachability: Reachability,
    options: HorizonOptions,
) -> HorizonPlan:
    """The plan before with the grasp to go for; without one if none can be intercepted."""
    time, X_OG, score, present = now.time, grasps.X_OG, grasps.score, None
    plan = replace(before, time=time)
    if before.X_OG is not None:
        errors = np.max(grasp_errors(X_OG, before.X_OG) / _SAME_GRASP, axis=1, initial=0.0)
        same = int(np.argmin(errors)) if len(errors) and errors.min() <= 1.0 else -1
        plan = replace(plan, seen=time if same >= 0 else before.seen)
        if same >= 0 or time < before.seen + options.patience:
            if time < before.ranked + options.rank_period - 1e-9:
                return plan
            kept, worth = (X_OG[same], score[same]) if same >= 0 else (before.X_OG, 1.0)
            X_OG, score = np.concatenate([X_OG, kept[None]]), np.append(score, worth)
            present = before.branch, before.psi
    plan = replace(plan, ranked=time)
    if len(X_OG) == 0:
        return replace(plan, X_OG=None)
    future = now.future(options.interception.times(time))
    found = find_interceptions(
        X_OG, future, now.q, now.v, reachability, options.interception, time, present
    )
    cost = total_cost(found, score, options)
    if present is not None:
        cost[-1] -= options.switch
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        return plan if present is not None else replace(plan, X_OG=None)
    return replace(
        plan,
        X_OG=X_OG[best],
        branch=int(found.branch[best]),
        psi=float(found.psi[best]),
        arrival=time + float(found.arrival[best]),
        q=found.q[best],
        v_arrival=found.v[best],
        seen=plan.seen if present is not None and best == len(cost) - 1 else time,
    )
