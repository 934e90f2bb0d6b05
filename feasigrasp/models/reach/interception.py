"""Interception of grasps of a moving object: which can be followed, from when on, and how long.

A grasp on a predicted path is *intercepted* at the first instant at which the joints can be there
with the velocity of the path, from their present positions and velocities and within their velocity
and acceleration limits; one that is farther away, as soon as they can be where it is at the last of
these instants. From there on its path is followed at fixed branch and arm angle until a
joint exceeds a limit of position, velocity or acceleration, or the arm collides. A grasp has many
configurations; the one of least cost counts::

    cost = interception time + lack max(0, enough - duration) + strain max(0, a - easy)

with the largest share ``a`` of the acceleration limits on the path. A hand that could not lift the
object from where the path has been followed to lacks a second. A good score of the grasp makes up
for some of it.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import ReachabilityError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Indices, record
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry import se3
from feasigrasp.models.ik.continuation import (
    branch_kernel,
    flange_pose_kernel,
    is_srs,
    redundancy_kernel,
    solve_kernel,
)
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.objects.prediction import Motion, PredictionModel, predicted_poses
from feasigrasp.models.quantities import (
    JOINT_RATES,
    MEASURED_POSITIONS,
    POSES,
    TWIST,
    UNKNOWN_POSE,
    ArrayOf,
    Count,
    NotNegative,
    Number,
    Positive,
    PositiveShare,
    Whole,
)
from feasigrasp.models.reach.kernels import (
    REACHABLE,
    Search,
    hand_verdict_kernel,
    is_admissible,
    make_scratch,
    next_kernel,
    start_kernel,
)
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.arm import ACCELERATION, VELOCITY

#: An arm that is late by less than this is in time: the errors of an arm that follows [s]. Source:
#: guessed.
_IN_TIME = 0.04
#: Branch and arm angle [rad]. Source: layout.
_CONFIGURATION = tuple[Annotated[int, Number(least=0)], float]


@dataclass(frozen=True)
class InterceptionOptions:
    """Instants, limits and cost weights of the search for interceptions.

    Attributes:
        step: Between the instants of the predicted path [s]; chosen so that a joint that swings at
            5 rad/s has 10 of them per period.
        instants: Number of instants.
        latest: Number of the last instant at which a grasp may be intercepted.
        tries: Configurations per grasp and instant, the nearest first.
        enough: Duration from which on longer is not better [s]; dwell, closing and squeezing take
            0.9 s.
        lack: Cost of a missing second [s]. It, ``strain`` and ``easy`` were chosen among two or
            three values on the circle at 0.6 m/s, seeds 101 to 103.
        strain: Cost of the largest share of the acceleration limits within ``enough`` [s] ...
        easy: ... beyond this share.
        velocity: Share of the velocity limits to get there, that of the safety filter.
        acceleration: Share of the acceleration limits, likewise.
        faster: A path may ask for this many times more velocity, since the arm angle need not stay
            fixed.
        harder: Likewise for acceleration.
        way_in: Distance behind the grasp that must be inside the joint limits as well [m].
        score: What a factor e in score is worth [s]; the prototype's choice.
        lift: Displacement of the hand that lifts the object, in the world [m].
    """

    step: Positive = 0.125
    instants: Count = 26
    latest: Whole = 13
    tries: Count = 4
    enough: NotNegative = 1.0
    lack: NotNegative = 2.0
    strain: NotNegative = 2.0
    easy: NotNegative = 0.7
    velocity: PositiveShare = 0.9
    acceleration: PositiveShare = 0.95
    faster: Positive = 1.1
    harder: Positive = 1.3
    way_in: NotNegative = 0.05
    score: NotNegative = 0.3
    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Raises ReachabilityError for a wrong number, or if ``latest`` is none of the instants."""
        check_fields(self, ReachabilityError)
        if self.latest >= self.instants:
            raise ReachabilityError(
                f"InterceptionOptions.latest = {self.latest}; give less than the {self.instants} "
                "instants"
            )

    @cached_property
    def record(self) -> NDArray[np.void]:
        """The options for kernels."""
        return record(self)

    @checked(ReachabilityError)
    def times(self, now: float) -> Array:
        """The instants from a time on [s]: multiples of ``step``, so that none recedes."""
        start = float(np.ceil(now / self.step - 1e-6) * self.step - now)
        return np.maximum(start, 0.0) + self.step * np.arange(self.instants)


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
        prediction: What the object is taken to do, a `PredictionModel`.
    """

    time: float
    q: Annotated[Array, MEASURED_POSITIONS]
    v: Annotated[Array, JOINT_RATES]
    X_WO: Annotated[Array, UNKNOWN_POSE]
    V_WO: Annotated[Array, TWIST]
    motion: Motion | None = None
    prediction: str = PredictionModel.PREDICTED

    def __post_init__(self) -> None:
        """Raises ReachabilityError for a wrong shape or unit."""
        check_fields(self, ReachabilityError)

    @property
    def known(self) -> bool:
        """Whether the object's pose and twist are."""
        return bool(np.isfinite(self.X_WO).all() and np.isfinite(self.V_WO).all())

    @checked(ReachabilityError)
    def future(self, ahead: Annotated[Array, ArrayOf(("k",), "s")]) -> Array:
        """Predicted poses (k, 4, 4) of the object at times from now on [s]."""
        return predicted_poses(self.prediction, self.motion, self.X_WO, self.V_WO, ahead)


class Interceptions(NamedTuple):
    """When and where n grasps are intercepted.

    Attributes:
        cost: See the module, shape (n,) [s]; infinite where there is none, as ``arrival``.
        arrival: Interception times from now on, shape (n,) [s].
        q: Configurations then, shape (n, 7) [rad].
        v: Their velocities, shape (n, 7) [rad/s].
        branch: Their branches, shape (n,).
        psi: Their arm angles, shape (n,) [rad].
    """

    cost: Array
    arrival: Array
    q: Array
    v: Array
    branch: Indices
    psi: Array


@checked(ReachabilityError)
def find_interceptions(
    X_OG: Annotated[Array, POSES],
    score: Annotated[Array, ArrayOf(("n",))],
    now: Situation,
    reachability: Reachability,
    options: InterceptionOptions,
    present: _CONFIGURATION | None = None,
) -> Interceptions:
    """Interceptions of grasps, each by its best configuration.

    Grasps are X_OG (n, 4, 4) [m] with a score (n,). The last one is bound to the ``present`` branch
    and arm angle [rad], if there is one. Raises ReachabilityError for an argument of another type
    or shape, or a pose that is none.
    """
    n, times = len(X_OG), options.times(now.time)
    if len(now.q) != reachability.arm.joints:
        raise ReachabilityError(f"now.q has {len(now.q)} entries, not one per joint of the arm")
    cost, q = np.full(n, np.inf), np.zeros((n, reachability.arm.joints))
    found = Interceptions(cost, cost.copy(), q, q.copy(), np.full(n, -1), np.zeros(n))
    ahead = _Ahead(
        np.array(now.future(times), dtype=float),
        float(times[0]),
        np.array(now.q, dtype=float),
        np.array(now.v, dtype=float),
        se3.inverse(reachability.gripper.X_FG),
        reachability.search,
        np.array(options.lift, dtype=float),
        options.record,
    )
    bound = (-1, 0.0) if present is None else present
    _interceptions_kernel(ahead, np.array(X_OG, dtype=float), *bound, found)
    worth = options.score * np.log(np.clip(score, 0.05, 1.0))  # lower scores count so; guessed
    return found._replace(cost=found.cost - worth)


class _Ahead(NamedTuple):
    """Poses (k, 4, 4) of the object, the first in ``start`` [s]; arm, hand, limits and options."""

    X_WO: Array
    start: float
    q: Array
    v: Array
    X_GF: Array
    search: Search
    lift: Array
    options: NDArray[np.void]


@compiled
def least_time_kernel(way, v_0, v_1, speed, acceleration):
    """Least time in which a joint goes ``way`` [rad] from velocity ``v_0`` to ``v_1`` [s].

    It accelerates, keeps ``speed`` if it reaches it, and decelerates. With the way d and the
    acceleration a, the peak is ``v_p = sqrt(a d + (v_0^2 + v_1^2) / 2)``.
    """
    direct = 0.5 * (v_0 + v_1) * abs(v_1 - v_0) / acceleration
    if way < direct:
        way, v_0, v_1 = -way, -v_0, -v_1
    square = 0.5 * (v_0 * v_0 + v_1 * v_1)
    peak = np.sqrt(max(acceleration * way + square, 0.0))
    if peak <= speed:
        return (2.0 * peak - v_0 - v_1) / acceleration
    plateau = (way - (speed * speed - square) / acceleration) / speed
    return (2.0 * speed - v_0 - v_1) / acceleration + plateau


@compiled
def _late_kernel(ahead, k, there, v_there):
    """How late the arm is at instant k in a configuration (7,) with velocities (7,) [s]."""
    o, chain = ahead.options[0], ahead.search.chain
    late = 0.0
    for j in range(len(there)):
        least = least_time_kernel(
            *(there[j] - ahead.q[j], ahead.v[j], v_there[j]),
            *(o.velocity * chain[j, VELOCITY], o.acceleration * chain[j, ACCELERATION]),
        )
        late = max(late, least - (ahead.start + o.step * k))
    return late


@compiled
def _follow_kernel(ahead, k, X_OG, q, branch, psi, v):
    """Follows a grasp from instant k on for ``enough``; writes the first velocity into v (7,).

    Returns the number of steps, none if the arm is late or collides at once, and the largest share
    of the acceleration limits.
    """
    o, search, chain = ahead.options[0], ahead.search, ahead.search.chain
    X_WF, ends = np.empty((4, 4)), np.empty(search.fixed.shape)
    before, after, v_before, hardest = q.copy(), q.copy(), np.zeros(len(q)), 0.0
    end = k + int(o.enough / o.step)
    last = min(len(ahead.X_WO), k + 2 + int(np.ceil(o.enough / o.step)))
    for m in range(k + 1, last):
        flange_pose_kernel(ahead.X_WO[m], X_OG, 0.0, ahead.X_GF, X_WF)
        if not solve_kernel(chain, X_WF, branch, psi, after):
            return m - k - 1, hardest
        for j in range(len(q)):
            speed = (after[j] - before[j]) / o.step
            share = abs(speed - v_before[j]) / (o.step * chain[j, ACCELERATION])
            too_hard = m > k + 1 and share > o.harder * o.acceleration
            if too_hard or abs(speed) > o.faster * o.velocity * chain[j, VELOCITY]:
                return m - k - 1, hardest
            if k + 1 < m <= end:
                hardest = max(hardest, share)
            v_before[j] = speed
        if m == k + 1:
            v[:] = v_before
            late = k < int(o.latest) and _late_kernel(ahead, k, q, v) > _IN_TIME
            if late or not is_admissible(q, search.open, search, search.floor):
                return 0, hardest
        clear = hand_verdict_kernel(X_WF, search, ends) == REACHABLE
        if not (clear and is_admissible(after, search.open, search, search.floor)):
            return m - k - 1, hardest
        before[:] = after
    return last - 1 - k, hardest


@compiled
def _cost_kernel(ahead, k, X_OG, there, branch, psi, v_there):
    """Cost of an interception at instant k in a configuration (7,), and when it is [s].

    It is infinite if the arm is not there in time, collides there, or cannot stand back; at the
    last instant it may be late. A lift out of the joint limits counts as a missing second.
    """
    o, chain = ahead.options[0], ahead.search.chain
    due = ahead.start + o.step * k
    steps, hardest = _follow_kernel(ahead, k, X_OG, there, branch, psi, v_there)
    if steps == 0:
        return np.inf, np.inf
    late = _late_kernel(ahead, k, there, v_there)
    X_WF, behind = np.empty((4, 4)), there.copy()
    flange_pose_kernel(ahead.X_WO[k], X_OG, o.way_in, ahead.X_GF, X_WF)
    if not solve_kernel(chain, X_WF, branch, psi, behind):
        return np.inf, np.inf
    if not inside_limits_kernel(chain, behind, ahead.search.limit_margin):
        return np.inf, np.inf
    lack = max(0.0, o.enough - o.step * steps)
    flange_pose_kernel(ahead.X_WO[k + steps], X_OG, 0.0, ahead.X_GF, X_WF)
    X_WF[:3, 3] += ahead.lift
    lifted = solve_kernel(chain, X_WF, branch, psi, behind)
    if not (lifted and inside_limits_kernel(chain, behind, ahead.search.limit_margin)):
        lack += 1.0
    arrival = due + late if late > _IN_TIME else due
    return arrival + o.lack * lack + o.strain * max(0.0, hardest - o.easy), arrival


@compiled
def _interceptions_kernel(ahead, X_OG, present_branch, present_psi, found):
    """Writes the fields of `Interceptions` of all grasps; a branch below 0 binds none of them."""
    o, q, search, chain = ahead.options[0], ahead.q, ahead.search, ahead.search.chain
    cost, arrival, q_there, v_there, branches, psis = found
    scratch, X_WF = make_scratch(search, q), np.empty((4, 4))
    there, velocity, last = q.copy(), np.empty(len(q)), int(o.latest)
    for i in range(len(X_OG)):
        bound, again, met = present_branch >= 0 and i == len(X_OG) - 1, False, True
        for at in range(last + 1):
            # Of an arm that is not S-R-S the later of two instants comes first; if none is met
            # then, none is looked for at the earlier one.
            k = at if bound or is_srs(chain) else min(at ^ 1, last)
            due = ahead.start + o.step * k
            if due >= cost[i] or (k < at and not met):
                continue
            met = False
            flange_pose_kernel(ahead.X_WO[k], X_OG[i], 0.0, ahead.X_GF, X_WF)
            if hand_verdict_kernel(X_WF, search, scratch.ends) != REACHABLE:
                continue
            if bound:
                there[:] = q
                if not solve_kernel(chain, X_WF, present_branch, present_psi, there):
                    continue
            else:
                most = due + _IN_TIME if k < last else np.inf
                circle = start_kernel(X_WF, q, search, scratch, most, again and k < last)
                again = True
                if not circle.reached:
                    continue
            for _ in range(1 if bound else int(o.tries)):
                if cost[i] <= due:  # none costs less
                    break
                if bound:
                    branch, psi = present_branch, present_psi
                else:
                    time = next_kernel(circle, search, scratch)
                    if time > due + _IN_TIME and (time == np.inf or k < last):
                        break
                    there[:] = scratch.q
                    psi = redundancy_kernel(chain, there)
                    branch = -1 if is_srs(chain) else scratch.seeds[16]
                    branch = branch_kernel(chain, there) if branch < 0 else branch
                one, then = _cost_kernel(ahead, k, X_OG[i], there, branch, psi, velocity)
                met |= one < np.inf
                if one < cost[i]:
                    cost[i], arrival[i], branches[i], psis[i] = one, then, branch, psi
                    q_there[i], v_there[i] = there, velocity
