"""Keeps a set of inverse-kinematics solutions up to date while grasps and object change.

Between two updates solutions move by themselves (`feasigrasp.models.control.joint.solutions`). An
update matches them with the grasps that are offered now, lets arm angles glide to where they cost
less, looks for new ones, and drops those that do not count. Nothing that counts appears or vanishes
at once: a new solution starts at a cost at which it has no influence, and costs change at a bounded
rate; one whose grasp is gone rises in cost until it has none. The paper draws them all anew
instead, from the same seed: `SolutionOptions.resample`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from feasigrasp.errors import ControlError
from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.choices import parse_choice
from feasigrasp.models.control.joint.resampling import length_scale_of, resampled_solutions
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.control.joint.sources import Source, new_configurations
from feasigrasp.models.control.planning.continuation import (
    branch_kernel,
    flange_pose_kernel,
    solve_kernel,
)
from feasigrasp.models.control.planning.prices import Prices
from feasigrasp.models.control.planning.strands import strand_cost_kernel
from feasigrasp.models.control.planning.transfers import way_kernel
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.funnel import Funnel, standoff_kernel
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.arm_circle import arm_angle_kernel
from feasigrasp.models.ik.closed_form import inside_limits_kernel, travel_time_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics, pose_jacobian_kernel

#: A solution counts nothing if going there is so many length scales longer than the best.
IRRELEVANT = 12.0
#: Grasps whose solutions are looked for at one update, once some are known.
GRASPS_AT_ONCE = 12
#: Grasps count as the same if no entry of their poses differs by more.
SAME_GRASP = 1e-9
# Step of arm angle at which costs are compared [rad]; how far their lowest point may be away, in
# steps; and the least that they count as bent between them [s].
_STEP, _MOST_STEPS, _LEAST_BEND = 0.08, 4.0, 1e-3
# Largest rate of the length scale [rad/s].
_LENGTH_SCALE_RATE = 0.2


@dataclass(frozen=True)
class SolutionOptions:
    """Which solutions are kept.

    Attributes:
        source: Where they come from: ``closed_form``, ``flow`` (drawn from the IK flow, refined) or
            ``dls`` (damped least squares from random configurations).
        n_solutions: How many are kept. The best one of every grasp comes first.
        resample: Whether they are drawn anew at every update, with the same random numbers, as in
            the paper, and cost nothing; from ``flow`` or ``dls``.
        length_scale: Of the field [rad]; 0 follows the spacing of the solutions.
        per_grasp: How many of one grasp, at most; not if they are drawn anew.
        cost_rate: How fast a cost changes at most [rad/s].
        glide: Largest rate of an arm angle [rad/s].
        glide_acceleration: Its largest change [rad/s^2].
        glide_gain: Rate per distance to the arm angle of least cost [1/s].
        radians_per_second: How far it is worth going for a solution that costs a second less.
    """

    source: str = Source.CLOSED_FORM
    n_solutions: int = 64
    resample: bool = False
    length_scale: float = 0.0
    per_grasp: int = 4
    cost_rate: float = 4.0
    glide: float = 0.6
    glide_acceleration: float = 3.0
    glide_gain: float = 2.0
    radians_per_second: float = 1.0

    def __post_init__(self) -> None:
        """Checks the choice."""
        source = parse_choice(Source, self.source, "source", ControlError)
        object.__setattr__(self, "source", source)
        if self.n_solutions < 1 or self.per_grasp < 1:
            raise ControlError(
                f"n_solutions is {self.n_solutions} and per_grasp {self.per_grasp}; "
                "give at least 1 of each"
            )
        if not 0.0 <= self.length_scale < np.inf:
            raise ControlError(
                f"length_scale is {self.length_scale}; give a positive one [rad], or 0 for that of "
                "the solutions' spacing"
            )
        if self.resample and source is Source.CLOSED_FORM:
            raise ControlError(
                "resample needs something to draw from: give the source flow or dls, or "
                "resample: false"
            )


class _Items(NamedTuple):
    """Solutions at the time of an update.

    Attributes:
        X_OG: Their grasps, shape (n, 4, 4).
        grasp: Which of the grasps on offer that is, -1 for none, shape (n,).
        branch: Their branches, shape (n,).
        psi: Arm angles, shape (n,) [rad].
        rate: Their rates, shape (n,) [rad/s].
        cost: Costs, shape (n,) [rad].
        target: What the costs should be, shape (n,) [rad].
        better: How far it is to the arm angle at which that is least, shape (n,) [rad].
        q: Configurations, shape (n, 7) [rad].
        reached: Whether there is one inside the joint limits, shape (n,).
    """

    X_OG: Array
    grasp: Indices
    branch: Indices
    psi: Array
    rate: Array
    cost: Array
    target: Array
    better: Array
    q: Array
    reached: Mask

    def select(self, which: Mask | Indices) -> _Items:
        return _Items._make(array[which] for array in self)

    def with_others(self, others: _Items) -> _Items:
        return _Items._make(np.concatenate(pair) for pair in zip(self, others, strict=True))


@njit(cache=True)
def _judge(
    q_now,
    X_FG,
    X_WO,
    X_OG,
    grasp_rates,
    standoffs,
    branch,
    psi,
    times,
    search,
    prices,
    q,
    reached,
    cost,
    better,
):
    """Writes configuration now, cost [s], and the way to a better arm angle, of every solution.

    ``X_WO`` (k, 4, 4) are the object's poses at ``times`` from now on. Beside what it costs to be
    there, which is the strand's cost, the way there costs what the hand is farther away meanwhile.
    Without a horizon nothing costs anything.
    """
    X_WF, scratch, values, price = np.empty((4, 4)), np.empty(IIWA_7.joints), np.empty(3), prices[0]
    X_GF = inverse_kernel(X_FG)
    pose_jacobian_kernel(q_now, X_FG, X_WF, None)
    start = np.linalg.norm(X_WF[:3, 3] - X_WO[0, :3, 3])
    for i in range(len(branch)):
        flange_pose_kernel(X_WO[0], X_OG[i], standoffs[i], X_GF, X_WF)
        reached[i] = solve_kernel(X_WF, branch[i], psi[i], q[i]) and inside_limits_kernel(
            q[i], IIWA_7.position_margin
        )
        if not reached[i] or len(times) == 1:
            continue
        for j in range(3):
            values[j] = strand_cost_kernel(
                *(X_WO, times, X_OG[i], grasp_rates[i], standoffs[i], X_GF),
                *(branch[i], psi[i] + (j - 1) * _STEP, search, price, X_WF, scratch),
            )
        travel = travel_time_kernel(q_now, q[i]) / price.speed_share
        way = way_kernel(
            *(q_now, q[i], 0, 0, travel, X_WO, times, start, standoffs[i], search, X_FG, price)
        )
        cost[i] = values[1] + max(0.0, way - travel * np.linalg.norm(X_OG[i, :3, 3]) / price.lost)
        # To the lowest point of the parabola through the three, a few steps at most.
        bend = max(values[2] - 2.0 * values[1] + values[0], _LEAST_BEND)
        steps = 0.5 * (values[0] - values[2]) / bend
        better[i] = _STEP * min(max(steps, -_MOST_STEPS), _MOST_STEPS)


@dataclass(frozen=True, eq=False)
class SolutionSearch:
    """Keeps solutions up to date.

    Attributes:
        reachability: Limits, clearances and the hand.
        funnel: The way into a grasp.
        prices: What solutions cost.
        options: Which solutions are kept.
        period: Time between updates [s].
    """

    reachability: Reachability
    funnel: Funnel
    prices: Prices
    options: SolutionOptions
    period: float

    def update(
        self,
        previous: Solutions,
        time: float,
        grasps: GraspSet,
        X_WO: Array,
        q: Array,
    ) -> Solutions:
        """The solutions for the next period.

        Args:
            previous: Those until now.
            time: Now [s].
            grasps: Grasps on offer, in the object frame, m of them.
            X_WO: Poses of the object at the prices' instants, now first, shape (k, 4, 4).
            q: Joint positions [rad], shape (7,).
        """
        X_OG, rates = grasps.X_OG, self.prices.grasp_rates(grasps)
        if self.options.resample:
            most, X_WF = self.options, self._flange_poses(X_OG, X_WO[0], q)
            return resampled_solutions(
                most.source, most.n_solutions, most.length_scale, time, X_OG, X_WF
            )
        angles, costs, scale = previous.at(min(max(time - previous.time, 0.0), self.period))
        grasp = matches(previous.X_OG, X_OG)
        of_grasp = np.append(rates, 0.0)[grasp]
        old = self._items(
            *(previous.X_OG, grasp, of_grasp, previous.branch, angles[:, 0], angles[:, 1]),
            *(costs, X_WO, q),
        )
        old.target[grasp < 0] = np.inf
        old = old.select(old.reached)
        best = float((_apart(old.q, q) + old.cost).min()) if len(old.q) else np.inf

        looked_at = np.arange(len(X_OG))
        if len(old.q) and len(X_OG) > GRASPS_AT_ONCE:
            looked_at = (previous.turn + np.arange(GRASPS_AT_ONCE)) % len(X_OG)
        new = self._new_items(old, X_OG, rates, looked_at, X_WO, q)
        if len(old.q):
            # Where they have no influence on what the arm does.
            np.maximum(new.cost, best + IRRELEVANT * scale - _apart(new.q, q), out=new.cost)
        items, n_kept = self._ranked(old, new, q, best + IRRELEVANT * scale)
        items.target[n_kept:] = np.inf

        period, most = self.period, self.options
        cost_rate = np.clip((items.target - items.cost) / period, -most.cost_rate, most.cost_rate)
        glide = np.clip(most.glide_gain * items.better, -most.glide, most.glide)
        acceleration = np.clip(
            (glide - items.rate) / period, -most.glide_acceleration, most.glide_acceleration
        )
        wanted = length_scale_of(items.q, self.options.length_scale)
        if len(old.q) == 0:
            scale = wanted
        scale_rate = np.clip((wanted - scale) / period, -_LENGTH_SCALE_RATE, _LENGTH_SCALE_RATE)
        return Solutions(
            items.X_OG,
            items.branch,
            np.column_stack([items.psi, items.rate, acceleration]),
            np.column_stack([items.cost, cost_rate]),
            np.array([scale, scale_rate]),
            time,
            int((previous.turn + len(looked_at)) % max(len(X_OG), 1)),
        )

    def _flange_poses(self, X_OG: Array, X_WO: Array, q: Array) -> Array:
        """Flange poses (n, 4, 4) on the way into grasps, as far as the hand has lined up."""
        X_GF = se3.inverse(self.reachability.gripper.X_FG)
        X_WF, standoffs = np.empty((len(X_OG), 4, 4)), self._standoffs(X_OG, X_WO, q)
        for k, X in enumerate(X_OG):
            flange_pose_kernel(X_WO, X, standoffs[k], X_GF, X_WF[k])
        return X_WF

    def _items(
        self,
        X_OG: Array,
        grasp: Indices,
        grasp_rates: Array,
        branch: Indices,
        psi: Array,
        rate: Array,
        cost: Array | None,
        X_WO: Array,
        q: Array,
    ) -> _Items:
        """Solutions with their configurations; cost: what it should be, if None."""
        n, X_FG = len(branch), self.reachability.gripper.X_FG
        standoffs = self._standoffs(X_OG, X_WO[0], q)
        configurations, reached = np.empty((n, IIWA_7.joints)), np.zeros(n, dtype=bool)
        target, better = np.zeros(n), np.zeros(n)
        _judge(
            *(q, X_FG, X_WO, X_OG, grasp_rates, standoffs, branch, psi, self.prices.instants),
            *(self.reachability.search, self.prices.record),
            *(configurations, reached, target, better),
        )
        target *= self.options.radians_per_second
        cost = target.copy() if cost is None else cost
        return _Items(X_OG, grasp, branch, psi, rate, cost, target, better, configurations, reached)

    def _new_items(
        self,
        old: _Items,
        X_OG: Array,
        grasp_rates: Array,
        looked_at: Indices,
        X_WO: Array,
        q: Array,
    ) -> _Items:
        """Solutions of some of the grasps that are apart from those there are."""
        X_WF = self._flange_poses(X_OG[looked_at], X_WO[0], q)
        found = new_configurations(
            self.options.source,
            X_WF,
            q,
            [old.q[old.grasp == g] for g in looked_at],
            self.options.per_grasp,
            self.reachability.search,
            self.prices,
            self.options.radians_per_second,
        )
        grasp = np.repeat(looked_at, [len(one) for one in found])
        configurations = np.concatenate([*found, np.empty((0, IIWA_7.joints))])
        psi = np.array([arm_angle_kernel(one) for one in configurations])
        branch = np.array([branch_kernel(one) for one in configurations], dtype=np.int64)
        items = self._items(
            *(X_OG[grasp], grasp, grasp_rates[grasp], branch, psi, np.zeros(len(psi))),
            *(None, X_WO, q),
        )
        return items.select(items.reached)

    def _ranked(self, old: _Items, new: _Items, q: Array, relevant: float) -> tuple[_Items, int]:
        """The solutions that stay, best first, and how many of them are there to stay.

        The best one of each grasp comes first. Beyond the number that is kept, and without a grasp,
        only those remain that count now; they leave slowly.
        """
        items = old.with_others(new)
        way = _apart(items.q, q)
        order = np.argsort(way + np.minimum(items.target, 1e3), kind="stable")
        _, first = np.unique(items.grasp[order], return_index=True)
        later = np.ones(len(order), dtype=bool)
        later[first] = False
        order = order[np.argsort(later | (items.grasp[order] < 0), kind="stable")]
        counts = (way + items.cost < relevant) & (np.arange(len(way)) < len(old.q))
        counts, offered = counts[order], items.grasp[order] >= 0
        stays = counts | offered
        stays[self.options.n_solutions :] = counts[self.options.n_solutions :]
        n_kept = int(stays[: self.options.n_solutions].sum())
        return items.select(order[stays]), n_kept

    def _standoffs(self, X_OG: Array, X_WO: Array, q: Array) -> Array:
        X_OH = se3.inverse(X_WO) @ forward_kinematics(q, self.reachability.gripper.X_FG)
        return np.array([standoff_kernel(X, X_OH, self.funnel.parameters) for X in X_OG])


def _apart(configurations: Array, q: Array) -> Array:
    return np.asarray(np.linalg.norm(configurations - q, axis=1))


def matches(X_OA: Array, X_OB: Array) -> Indices:
    """For each pose of the one set, the index of the same pose in the other, or -1, shape (n,)."""
    if len(X_OA) == 0 or len(X_OB) == 0:
        return np.full(len(X_OA), -1)
    apart = np.abs(X_OA[:, None, :3] - X_OB[None, :, :3]).max(axis=(2, 3))
    nearest = apart.argmin(axis=1)
    same = apart[np.arange(len(X_OA)), nearest] < SAME_GRASP
    return np.where(same, nearest, -1)
