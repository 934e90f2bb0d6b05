"""Receding-horizon control towards the grasps of a moving object that can be followed.

Ten times a second all grasps are ranked by their interceptions, and the best one is selected, with
hysteresis. Fifty times a second one step of the optimal control problem over the next second is
solved, about the plan before. Its cost has the distance to a reference
(`feasigrasp.models.control.horizon.reference`) and one of two terms over the grasps near the
selected one: in task space the negative log density of a Riemannian mixture, in joint space the
distance field over their inverse kinematics solutions.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Self

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.choices import ControlSpace, parse_word
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.clearance import clearance_kernel
from feasigrasp.models.control.horizon.density import density_kernel
from feasigrasp.models.control.horizon.distance import distance_kernel
from feasigrasp.models.control.horizon.knots import Form, Knots, Meeting, Neighbours, Surface
from feasigrasp.models.control.horizon.program import ProgramOptions, positions, solve_program
from feasigrasp.models.control.horizon.reference import INSTANT, reference_kernel
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import NO_GRID, ObstacleGrid
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, grasp_errors
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.continuation import branch_kernel, redundancy_kernel
from feasigrasp.models.objects.prediction import PredictionModel
from feasigrasp.models.quantities import Count, NotNegative, Positive
from feasigrasp.models.reach.interception import (
    InterceptionOptions,
    Interceptions,
    Situation,
    find_interceptions,
)
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Grasps this close to the selected one are its neighbours [m, rad]. Source: guessed.
_NEIGHBOUR = np.array([0.05, 0.6])
#: No grasp. Source: definition.
_NO_GRASP = Neighbours(np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class HorizonOptions:
    """Options of the law.

    Attributes:
        prediction: What the object is taken to do, a `PredictionModel`.
        rank_period: Between rankings [s], the period of the grasps.
        switch: What another grasp must save [s]; the prototype's choice, as the next.
        patience: A grasp that is not offered any more is followed for this time [s].
        neighbours: Most grasps that the term is over; 1 for the selected one alone.
        corridor: The approach corridor.
        interception: What can be followed.
        program: Knots and weights.
    """

    prediction: str = PredictionModel.PREDICTED
    rank_period: Positive = 0.1
    switch: NotNegative = 0.3
    patience: NotNegative = 0.5
    neighbours: Count = 6
    corridor: ApproachCorridor = field(default_factory=ApproachCorridor)
    interception: InterceptionOptions = field(default_factory=InterceptionOptions)
    program: ProgramOptions = field(default_factory=ProgramOptions)

    def __post_init__(self) -> None:
        """Raises ControlError for a wrong number, or where there is no such prediction."""
        check_fields(self, ControlError)
        parse_word(PredictionModel, self.prediction, "HorizonOptions.prediction", ControlError)


@dataclass(frozen=True, eq=False)
class HorizonPlan(Frozen):
    """A plan, and the grasps that it leads to.

    Attributes:
        time: When it was made [s].
        v: Joint velocities at the knots, shape (N + 1, 7) [rad/s]; None before the first plan.
        near: The selected grasp and its neighbours; none without one.
        arrival: Interception time of the selected one [s].
        q: Configuration then, shape (7,) [rad].
        v_arrival: Its velocity, shape (7,) [rad/s].
        ranked: When the grasps were ranked [s].
        score: Score of the selected grasp.
        seen: When the selected grasp was last offered and could be intercepted [s].
    """

    time: float = -np.inf
    v: Array | None = None
    near: Neighbours = _NO_GRASP
    arrival: float = 0.0
    q: Array = field(default_factory=lambda: np.zeros(0))
    v_arrival: Array = field(default_factory=lambda: np.zeros(0))
    ranked: float = -np.inf
    seen: float = -np.inf
    score: float = 1.0

    @property
    def X_OG(self) -> Array | None:
        """The selected grasp, shape (4, 4) [m]; None without one."""
        return self.near.X_OG[0] if len(self.near.X_OG) else None

    def without_grasp(self, time: float) -> Self:
        """The plan at a time [s], with no grasp selected."""
        return replace(self, time=time, near=_NO_GRASP)


@checked(ControlError)
def next_plan(
    before: HorizonPlan,
    now: Situation,
    grasps: GraspSet,
    reachability: Reachability,
    options: HorizonOptions,
    space: ControlSpace,
    *,
    committed: bool = False,
    surface: ObstacleGrid | None = None,
) -> HorizonPlan:
    """The next plan; without a grasp if none can be intercepted, or the object is unknown.

    The grasps on offer are in O, the term over them is that of ``space``. A ``committed`` hand is
    closing, or has closed, on the first of them; the open hand keeps off the object's ``surface``,
    in O. Raises ControlError for an argument of another type.
    """
    if not now.known:
        return before.without_grasp(now.time)
    if committed and len(grasps):
        plan = _committed(before, now, grasps.X_OG[0], reachability.arm.chain)
    else:
        plan = _selected(before, now, grasps, reachability, options)
    if plan.X_OG is None:
        return plan
    program, n = options.program, len(options.program.steps)
    joints = reachability.arm.joints
    v, X_FG = _shifted(before, now, program), reachability.gripper.X_FG
    knots = _knots(now, v, program)
    meeting = Meeting(
        *(np.array(now.q), np.array(now.v), plan.arrival - now.time),
        *(np.array(plan.q), np.array(plan.v_arrival)),
    )
    form = Form(*(np.empty((n, *shape)) for shape in ((joints, joints), (joints,), (joints,))))
    grid, clearance = surface or NO_GRID, program.safety.object_clearance
    kept_off = Surface(_open_hand(reachability.gripper), grid.values, grid.frame, clearance)
    corridor = options.corridor.parameters
    _shared_kernel(knots, plan.near, meeting, kept_off, corridor, X_FG, program.record, form)
    add = density_kernel if space == ControlSpace.TASK else distance_kernel
    add(knots, plan.near, corridor, se3.inverse(X_FG), program.record, form)
    solved = solve_program(now.q, v, form, program)
    if solved is None:  # brake
        solved = v[0] * np.linspace(1.0, 0.0, n + 1)[:, None]
    return replace(plan, v=solved)


def _knots(now: Situation, v: Array, program: ProgramOptions) -> Knots:
    """The plan with velocities (N + 1, 7) [rad/s] at its knots; poses of the hand are left open."""
    times, n = program.times[1:], len(program.steps)
    X_WO, after = now.future(np.concatenate([times, times + INSTANT])).reshape(2, n, 4, 4)
    return Knots(
        *(program.safety.arm.chain, times, positions(now.q, v, program)),
        *(np.empty((n, 4, 4)), np.empty((n, 6, len(now.q)))),
        *(np.array(X_WO), np.array(after), np.empty(n)),
    )


@lru_cache(maxsize=8)
def _open_hand(gripper: Gripper) -> Array:
    """Points on the outside of the open hand, in G, shape (k, 3) [m]."""
    return gripper.surface_points(gripper.max_opening)


@compiled
def _shared_kernel(knots, grasps, meeting, surface, corridor, X_FG, options, form):
    """Writes what both spaces share: the distance to the reference, and the object's clearance."""
    o, (count, n) = options[0], knots.q.shape
    for k in range(count):
        pose_jacobian_kernel(knots.chain, knots.q[k], X_FG, knots.X_WH[k], knots.J_WH[k])
    q_ref, X_GF = np.empty((count, n)), inverse_kernel(X_FG)
    reference_kernel(knots, grasps, meeting, corridor, X_GF, o.near, q_ref, form.v_ref)
    for k in range(count):
        for j in range(n):
            form.g[k, j] = o.joint * (knots.q[k, j] - q_ref[k, j])
            for i in range(n):
                form.H[k, j, i] = o.joint if i == j else 0.0
    if surface.values.size > 0:
        clearance_kernel(knots, grasps, surface, corridor, o.clearance, form)


def plan_velocity(plan: HorizonPlan, time: float, options: ProgramOptions) -> Array:
    """Joint velocity (7,) [rad/s] of a plan for the tick that begins at a time [s]."""
    if plan.X_OG is None or plan.v is None:
        return np.zeros(options.safety.arm.joints)
    at = time - plan.time + options.safety.period
    return np.array([np.interp(at, options.times, column) for column in plan.v.T])


def _shifted(before: HorizonPlan, now: Situation, options: ProgramOptions) -> Array:
    """Velocities of the plan before at the knots from now on, the first those of the arm."""
    if before.v is None or before.X_OG is None:
        return np.vstack([now.v, np.zeros((len(options.steps), len(now.v)))])
    at = options.times + now.time - before.time
    v = np.array([np.interp(at, options.times, column) for column in before.v.T]).T
    return np.vstack([now.v, np.clip(v[1:], -options.most_v, options.most_v)])


def _committed(before: HorizonPlan, now: Situation, X_OG: Array, chain: Array) -> HorizonPlan:
    """The plan before with the grasp that the hand closes on, in the present configuration.

    A hand that cannot follow any more stays where it is.
    """
    q = np.array(now.q)
    plan = replace(before, time=now.time, arrival=now.time, q=q, v_arrival=np.zeros(len(q)))
    if before.X_OG is not None and np.array_equal(X_OG, before.X_OG):
        X_OG, branch, psi, penalty = before.near
        return replace(plan, near=Neighbours(X_OG[:1], branch[:1], psi[:1], penalty[:1]))
    branch, psi = np.array([branch_kernel(chain, q)]), np.array([redundancy_kernel(chain, q)])
    return replace(plan, near=Neighbours(np.array(X_OG)[None], branch, psi, np.zeros(1)))


def _selected(
    before: HorizonPlan,
    now: Situation,
    grasps: GraspSet,
    reachability: Reachability,
    options: HorizonOptions,
) -> HorizonPlan:
    """The plan before with the grasps to go for; without one if none can be intercepted."""
    time, X_OG, score, present, same = now.time, grasps.X_OG, grasps.score, None, -1
    plan = replace(before, time=time)
    if before.X_OG is not None:
        # A grasp that is sampled anew is taken for the selected one if so close [m, rad]; guessed.
        close = np.array([0.012, 0.25])
        errors = np.max(grasp_errors(X_OG, before.X_OG) / close, axis=1, initial=0.0)
        if len(errors) and errors.min() <= 1.0:
            same = int(np.argmin(errors))
        if same >= 0 or time < before.seen + options.patience:
            if time < before.ranked + options.rank_period - 1e-9:
                return plan
            kept, worth = (X_OG[same], score[same]) if same >= 0 else (before.X_OG, before.score)
            X_OG, score = np.concatenate([X_OG, kept[None]]), np.append(score, worth)
            present = int(before.near.branch[0]), float(before.near.psi[0])
    plan = replace(plan, ranked=time)
    if len(X_OG) == 0:
        return plan.without_grasp(time)
    found = find_interceptions(X_OG, score, now, reachability, options.interception, present)
    cost = found.cost.copy()
    if present is not None:
        cost[-1] -= options.switch
    best = int(np.argmin(cost))
    if not np.isfinite(cost[best]):
        waits = present is not None and time < before.seen + options.patience
        return plan if waits else plan.without_grasp(time)
    near = _neighbours(best, X_OG, found, options.neighbours)
    penalty = np.maximum(found.cost[near] - found.cost[best], 0.0)
    return replace(
        plan,
        near=Neighbours(X_OG[near], found.branch[near], found.psi[near], penalty),
        arrival=time + float(found.arrival[best]),
        q=found.q[best],
        v_arrival=found.v[best],
        score=float(score[best]),
        seen=before.seen if present is not None and same < 0 and best == len(cost) - 1 else time,
    )


def _neighbours(best: int, X_OG: Array, found: Interceptions, most: int) -> Indices:
    """Indices of a grasp and of those near it, the nearest first, shape (m,)."""
    errors = np.max(grasp_errors(X_OG, X_OG[best]) / _NEIGHBOUR, axis=1)
    errors[errors < 1e-6] = np.inf  # the same, in another configuration
    errors[best] = -1.0
    apart = np.abs(found.q - found.q[best]).max(axis=1)
    # Neighbours are held in configurations this close [rad]; guessed.
    near = np.isfinite(found.cost) & (errors < 1.0) & (apart < 0.6)
    near &= found.branch == found.branch[best]
    order = np.argsort(errors, kind="stable")
    return order[near[order]][:most]
