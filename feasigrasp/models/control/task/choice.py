"""Selection of grasp, branch and arm angle by least cost over the prediction horizon.

An object that turns, or that goes round the robot's base, takes every grasp out of the arm's reach
sooner or later. A controller that follows the nearest grasp until a limit stops it loses the object
for long, and where it ends up is chance. Here the object's motion is predicted, and all
*candidates* (a grasp or its 180-degree flip, and one of the eight inverse-kinematics branches, over
all arm angles) are followed along it until they end at a joint limit, a collision or the table.
What is minimised is the distance of hand and object, added up over the time that is looked ahead:

- of the motion to a candidate, at the joints' speed limits, to where its grasp will be;
- of being there: the grasp's own distance from the object's centre, penalties for a low score and
  for a low density of the mixture of all grasps, for low manipulability and for being close to a
  joint limit;
- of its end: a terminal cost that falls with the time until then.

The present candidate may also be left later, for what will then be best. So the arm changes grasps
in time, takes the way round that is shorter in the long run, and unwinds before a limit stops it.

The grasps round the chosen one are weighed by the same costs, ``exp(-cost / temperature)``; what
the hand goes for follows from that (`feasigrasp.models.control.task.target`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arrays import Array, Frozen
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.control.planning.branch_switches import (
    BranchSwitch,
    Plan,
    branch_switch_kernel,
    remaining_cost_kernel,
)
from feasigrasp.models.control.planning.candidate_graph import candidate_graph_kernel
from feasigrasp.models.ik.continuation import branch_kernel
from feasigrasp.models.control.planning.cost_weights import CostWeights, instant_at
from feasigrasp.models.objects.predicted_poses import PredictionModel
from feasigrasp.models.control.task.target import neighbours
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, grasp_errors
from feasigrasp.models.ik.self_motion import arm_angle
from feasigrasp.models.reach.reachability import Reachability

#: A grasp this close to the chosen one is taken for it when grasps are sampled anew [m, rad].
#: Source: guessed.
SAME_GRASP = np.array([0.012, 0.25])
#: Of a grasp that is better than the chosen one by far, the weight is e to this. Source: numerical.
_MOST = 50.0


@dataclass(frozen=True)
class ChoiceOptions:
    """Options for the selection of a grasp candidate.

    Attributes:
        costs: How far is looked ahead, and what is charged.
        prediction: What the object is taken to do meanwhile, a `PredictionModel`.
        hysteresis: A grasp is kept at least so long [s].
        commitment: Another candidate must be better by this much [s], and so must it be to be on
            this one later than was planned before.
        temperature: Grasps near the chosen one weigh e times less per so much cost [s].
        neighbourhood: How near that is [m], see `neighbours`; 0 for none but the chosen one.
        smoothing: Share of the way to a new arm angle that is gone when a choice is confirmed.
        corridor: The way into a grasp.
    """

    costs: CostWeights = field(default_factory=CostWeights)
    prediction: str = PredictionModel.PREDICTED
    hysteresis: float = 0.3
    commitment: float = 1.0
    temperature: float = 0.2
    neighbourhood: float = 0.04
    smoothing: float = 0.25
    corridor: ApproachCorridor = field(default_factory=ApproachCorridor)

    def __post_init__(self) -> None:
        """Checks the word.

        Raises:
            ControlError: There is no such look-ahead.
        """
        parse_choice(PredictionModel, self.prediction, "prediction", ControlError)


@dataclass(frozen=True, eq=False)
class GraspChoice(Frozen):
    """The selected candidate.

    Attributes:
        X_OG: The grasp in the object frame, shape (4, 4) [m].
        branch: Its inverse-kinematics branch, see `feasigrasp.models.ik.self_motion`; -1 for no
            choice.
        psi: Arm angle to be at by the time ``interception_time`` [rad].
        interception_time: When that is [s].
        since: When this candidate was chosen [s].
        count: Number of changes of the candidate.
        cost: Of the plan [s].
        rate: What a second at the grasp costs by itself.
        steps: Tangent vectors to the grasps near it that can be held in its branch, itself first,
            shape (m, 6) [rad; m].
        weights: Of these grasps, shape (m,).
    """

    X_OG: Array = field(default_factory=lambda: np.eye(4))
    branch: int = -1
    psi: float = 0.0
    interception_time: float = 0.0
    since: float = -np.inf
    count: int = 0
    cost: float = np.inf
    rate: float = 0.0
    steps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    weights: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        steps, weights = np.array(self.steps), np.array(self.weights)
        self._freeze(X_OG=np.array(self.X_OG), steps=steps, weights=weights)

    def __bool__(self) -> bool:
        """Whether there is a choice."""
        return self.branch >= 0


def choose_grasp(
    choice: GraspChoice,
    t: float,
    q: Array,
    X_OG: Array,
    grasp_rates: Array,
    X_WO: Array,
    reachability: Reachability,
    options: ChoiceOptions,
    *,
    committed: bool = False,
) -> GraspChoice:
    """Confirms or changes the choice; to be called 10 to 50 times a second.

    Args:
        choice: The present one; ``GraspChoice()`` at first.
        t: Time [s].
        q: Joint positions [rad], shape (7,).
        X_OG: Hand poses to choose from, flips included, in the object frame, shape (n, 4, 4) [m].
        grasp_rates: What a second at each of them costs by itself, shape (n,), see
            `CostWeights.grasp_rates`.
        X_WO: Predicted poses of the object, shape (K + 1, 4, 4), at the instants
            ``options.costs.instants_from(t, choice.interception_time)``.
        reachability: Test of configurations.
        options: Horizon and cost weights.
        committed: Whether the hand is closing, or has closed, on the first of the grasps. Then it
            stays in its branch, whatever that costs: the way to another one leads away from the
            object, or takes it along.

    Returns:
        The choice; none (false) if nothing can be reached within the horizon.
    """
    q = np.ascontiguousarray(q, dtype=float)
    if len(X_OG) == 0 or not (np.isfinite(X_WO).all() and np.isfinite(q).all()):
        return GraspChoice(count=choice.count)
    X_FG, X_GF = reachability.gripper.X_FG, np.linalg.inv(reachability.gripper.X_FG)
    times, costs = options.costs.instants_from(t, choice.interception_time), options.costs.record
    search = reachability.search
    # Copies, so that no kernel is compiled twice, for arrays that may and may not be written.
    poses, grasps = np.array(X_WO, dtype=float), np.array(X_OG, dtype=float)
    graph = candidate_graph_kernel(q, poses, times, grasps, grasp_rates, X_GF, search, costs)
    problem = Plan(graph, poses, times, grasps, X_FG, options.corridor.parameters, search, costs)
    if committed:
        choice = _held(choice, t, q, grasps[0], float(grasp_rates[0]))
    no_candidate, present = (-1, -1), 0 if committed else present_index(choice, grasps)
    plan, margin = None, 0.0
    if present >= 0:
        plan = _confirmed(q, present, choice, t, problem, options)
        kept = plan.grasp >= 0 and t - choice.since < options.hysteresis
        margin = np.inf if kept else options.commitment
    if committed and (plan is None or plan.grasp < 0):
        return choice
    if not committed:
        skipped = no_candidate if plan is None else (present, choice.branch)
        other = branch_switch_kernel(q, 0, len(times) - 1, no_candidate, skipped, problem)
        if plan is None or plan.grasp < 0 or other.cost < plan.cost - margin:
            return _changed(choice, t, q, other, grasp_rates, reachability, problem, options)
    assert plan is not None
    # The arm angles are a grid: a part of the way each time makes a smooth path of it.
    change = (_arm_angle(reachability, plan.angle) - choice.psi + np.pi) % (2.0 * np.pi) - np.pi
    return GraspChoice(
        grasps[present],
        choice.branch,
        choice.psi + options.smoothing * change,
        t + times[plan.instant],
        choice.since,
        choice.count,
        plan.cost,
        grasp_rates[present],
        *_weighed(q, present, choice.branch, problem, options),
    )


def _changed(
    choice: GraspChoice,
    t: float,
    q: Array,
    way: BranchSwitch,
    grasp_rates: Array,
    reachability: Reachability,
    problem: Plan,
    options: ChoiceOptions,
) -> GraspChoice:
    """The choice of the candidate at the end of a branch switch; none without one."""
    if way.grasp < 0:
        return GraspChoice(count=choice.count)
    return GraspChoice(
        problem.X_OG[way.grasp],
        way.branch,
        _arm_angle(reachability, way.angle),
        t + problem.times[way.instant],
        t,
        choice.count + 1,
        way.cost,
        grasp_rates[way.grasp],
        *_weighed(q, way.grasp, way.branch, problem, options),
    )


def _held(choice: GraspChoice, t: float, q: Array, X_OG: Array, rate: float) -> GraspChoice:
    """The choice of a hand that closes on a grasp: in the branch that the arm is in.

    The hand may be at another grasp than it went for, or on its way to another branch.
    """
    branch = int(branch_kernel(q))
    if choice.branch == branch and np.array_equal(choice.X_OG, X_OG):
        return choice
    return GraspChoice(X_OG, branch, arm_angle(q), t, t, choice.count, rate=rate)


def _confirmed(
    q: Array, grasp: int, choice: GraspChoice, t: float, problem: Plan, options: ChoiceOptions
) -> BranchSwitch:
    """The plan that keeps a candidate, with the interception time planned before if possible."""
    plan, _ = remaining_cost_kernel(q, len(problem.times) - 1, grasp, choice.branch, problem)
    if plan.grasp < 0 or t >= choice.interception_time:
        return plan
    interception_time = instant_at(choice.interception_time - t, problem.times)
    kept, _ = remaining_cost_kernel(q, interception_time, grasp, choice.branch, problem)
    return kept if kept.grasp >= 0 and kept.cost < plan.cost + options.commitment else plan


def present_index(choice: GraspChoice, X_OG: Array) -> int:
    """Index of the grasp that was chosen among grasps (n, 4, 4), or of the one in its place.

    -1 if there is none any more, or nothing was chosen.
    """
    if not choice or len(X_OG) == 0:
        return -1
    errors = np.max(grasp_errors(X_OG, choice.X_OG) / SAME_GRASP, axis=1)
    index = int(np.argmin(errors))
    return index if errors[index] <= 1.0 else -1


def _weighed(
    q: Array, index: int, branch: int, problem: Plan, options: ChoiceOptions
) -> tuple[Array, Array]:
    """Steps to the grasps round one that can be held in its branch, and their weights."""
    some, steps = neighbours(problem.X_OG, index, options.neighbourhood)
    end = len(problem.times) - 1
    cost = np.array(
        [branch_switch_kernel(q, 0, end, (i, branch), (-1, -1), problem).cost for i in some]
    )
    if not np.isfinite(cost[0]):
        return steps[:1], np.ones(1)
    weights = np.exp(np.minimum((cost[0] - cost) / options.temperature, _MOST))
    return steps, weights


def _arm_angle(reachability: Reachability, index: int) -> float:
    return float(reachability.search.psis[index])
