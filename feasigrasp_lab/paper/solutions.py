"""Inverse kinematics solutions of grasps with a fixed branch and arm angle, and their update.

The closed form gives the configuration of a candidate (`feasigrasp.models.ik.continuation`) at its
arm angle anew at any pose of the object: the paper's "resample with the same seed" without a seed.

As grasps and object change, an update matches the solutions with the grasps that are offered now,
looks for new ones, and drops those that do not count. All are worth the same, but nothing that
counts appears or vanishes at once: a new solution starts at a cost at which it has no influence,
and costs change at a bounded rate; one whose grasp is gone rises in cost until it has none.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.distance import distances_kernel, length_scale_kernel
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.ik.continuation import branch_kernel, flange_pose_kernel, solve_kernel
from feasigrasp.models.ik.self_motion import arm_angle_kernel, inside_limits_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.paper.options import PaperOptions, Source
from feasigrasp_lab.paper.sources import closed_form_configurations, flow_configurations

_CHAIN, _MARGIN = IIWA_7.chain, IIWA_7.position_margin

#: A solution counts nothing if going there is longer than the best by this number of length scales.
#: Source: numerical.
IRRELEVANT = 12.0
#: Grasps whose solutions are looked for at one update, once some are found, and solutions of one
#: grasp, at most. Source: numerical, guessed.
GRASPS_AT_ONCE, PER_GRASP = 12, 4
#: Grasps count as the same if no entry of their poses differs by more. Source: numerical.
SAME_GRASP = 1e-9
#: Largest rates of a cost and of the length scale [rad/s]. Source: guessed.
COST_RATE, _LENGTH_SCALE_RATE = 4.0, 0.2


@dataclass(frozen=True, eq=False)
class Solutions(Frozen):
    """Grasps, each with a branch and an arm angle; costs are functions of the time since ``time``.

    Attributes:
        X_OG: Grasps in the object frame, shape (n, 4, 4) [m].
        branch: Branches ``4 elbow + 2 shoulder + wrist`` as in `closed_form`, shape (n,).
        arm_angle: Arm angles, shape (n,) [rad].
        cost: Cost and its rate, shape (n, 2) [rad, rad/s].
        length_scale: Length scale of the field and its rate [rad, rad/s], shape (2,).
        time: When they were updated [s].
        turn: Which grasp is looked at next, in a round of all.
    """

    X_OG: Array
    branch: Indices
    arm_angle: Array
    cost: Array
    length_scale: Array
    time: float = 0.0
    turn: int = 0

    def __post_init__(self) -> None:
        """Makes contiguous arrays."""
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                dtype = np.int64 if f.name == "branch" else np.float64
                object.__setattr__(self, f.name, np.ascontiguousarray(value, dtype=dtype))

    def __len__(self) -> int:
        """Number of solutions."""
        return len(self.branch)

    @classmethod
    def empty(cls, time: float = 0.0) -> Solutions:
        """No grasp can be reached."""
        return cls(
            *(np.zeros((0, 4, 4)), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2))),
            np.array([0.1, 0.0]),
            time,
        )

    def at(self, elapsed: float) -> tuple[Array, float]:
        """Costs (n,) [rad] and length scale [rad] after a time [s]."""
        cost = self.cost[:, 0] + elapsed * self.cost[:, 1]
        return cost, float(self.length_scale[0] + elapsed * self.length_scale[1])


class _Items(NamedTuple):
    """Solutions at the time of an update.

    Attributes:
        X_OG: Their grasps, shape (n, 4, 4).
        grasp: Which of the grasps on offer that is, -1 for none, shape (n,).
        branch: Their branches, shape (n,).
        psi: Arm angles, shape (n,) [rad].
        cost: Costs, shape (n,) [rad].
        target: What the costs should be: infinite without a grasp, else zero, shape (n,) [rad].
        q: Configurations, shape (n, 7) [rad].
    """

    X_OG: Array
    grasp: Indices
    branch: Indices
    psi: Array
    cost: Array
    target: Array
    q: Array


@compiled
def place_kernel(X_WO, X_OG, branch, arm_angle, X_GF, X_WF, q, index):
    """Writes the flange poses and configurations of all solutions that the arm may take.

    ``X_WF`` (n, 4, 4), ``q`` (n, 7) and ``index`` (n,), which solution each is, are filled from the
    front. Returns how many there are.
    """
    count = 0
    for i in range(len(branch)):
        flange_pose_kernel(X_WO, X_OG[i], 0.0, X_GF, X_WF[count])
        reached = solve_kernel(_CHAIN, X_WF[count], branch[i], arm_angle[i], q[count])
        if reached and inside_limits_kernel(_CHAIN, q[count], _MARGIN):
            index[count] = i
            count += 1
    return count


@dataclass(frozen=True, eq=False)
class SolutionSearch:
    """Keeps solutions up to date.

    Attributes:
        reachability: Limits, clearances and the hand.
        options: Source, length scale, and how many are kept; the best one of every grasp comes
            first.
        period: Time between updates [s].
    """

    reachability: Reachability
    options: PaperOptions
    period: float

    def update(
        self, previous: Solutions, time: float, X_OG: Array, X_WO: Array, q: Array
    ) -> Solutions:
        """The solutions for the next period, of grasps (m, 4, 4) in the object frame."""
        cost, scale = previous.at(min(max(time - previous.time, 0.0), self.period))
        grasp = matches(previous.X_OG, X_OG)
        target = np.where(grasp < 0, np.inf, 0.0)
        old = self._items(
            previous.X_OG, grasp, previous.branch, previous.arm_angle, cost, target, X_WO
        )
        best = float((_apart(old.q, q) + old.cost).min()) if len(old.q) else np.inf

        looked_at = np.arange(len(X_OG))
        if len(old.q) and len(X_OG) > GRASPS_AT_ONCE:
            looked_at = (previous.turn + np.arange(GRASPS_AT_ONCE)) % len(X_OG)
        new = self._new_items(old, X_OG, looked_at, X_WO, q)
        if len(old.q):
            # Where they have no influence on what the arm does.
            np.maximum(new.cost, best + IRRELEVANT * scale - _apart(new.q, q), out=new.cost)
        items, n_kept = self._ranked(old, new, q, best + IRRELEVANT * scale)
        items.target[n_kept:] = np.inf

        cost_rate = np.clip((items.target - items.cost) / self.period, -COST_RATE, COST_RATE)
        wanted = self.length_scale(items.q)
        if len(old.q) == 0:
            scale = wanted
        scale_rate = (wanted - scale) / self.period
        return Solutions(
            items.X_OG,
            items.branch,
            items.psi,
            np.column_stack([items.cost, cost_rate]),
            np.array([scale, np.clip(scale_rate, -_LENGTH_SCALE_RATE, _LENGTH_SCALE_RATE)]),
            time,
            int((previous.turn + len(looked_at)) % max(len(X_OG), 1)),
        )

    def length_scale(self, q: Array) -> float:
        """The length scale of a field over configurations (n, 7) [rad]: given, or by spacing."""
        if self.options.length_scale:
            return self.options.length_scale
        r = np.empty((len(q), len(q)))
        distances_kernel(q, r)
        return float(length_scale_kernel(r))

    def flange_poses(self, X_OG: Array, X_WO: Array) -> Array:
        """Flange poses (n, 4, 4) at grasps (n, 4, 4)."""
        X_GF, X_WF = se3.inverse(self.reachability.gripper.X_FG), np.empty((len(X_OG), 4, 4))
        for k, X in enumerate(X_OG):
            flange_pose_kernel(X_WO, X, 0.0, X_GF, X_WF[k])
        return X_WF

    def _items(
        self,
        X_OG: Array,
        grasp: Indices,
        branch: Indices,
        psi: Array,
        cost: Array,
        target: Array,
        X_WO: Array,
    ) -> _Items:
        """Those of some solutions that the arm may take, with their configurations."""
        n, X_GF = len(branch), inverse_kernel(self.reachability.gripper.X_FG)
        X_WF, q, index = np.empty((n, 4, 4)), np.empty((n, IIWA_7.joints)), np.zeros(n, dtype=int)
        count = place_kernel(X_WO, X_OG, branch, psi, X_GF, X_WF, q, index)
        found = (each[index[:count]] for each in (X_OG, grasp, branch, psi, cost, target))
        return _Items._make([*found, q[:count]])

    def _new_items(
        self, old: _Items, X_OG: Array, looked_at: Indices, X_WO: Array, q: Array
    ) -> _Items:
        """Solutions of some of the grasps that are apart from those there are."""
        X_WF = self.flange_poses(X_OG[looked_at], X_WO)
        previous = [old.q[old.grasp == g] for g in looked_at]
        closed_form = self.options.source == Source.CLOSED_FORM
        find = closed_form_configurations if closed_form else flow_configurations
        found = find(X_WF, q, previous, PER_GRASP, self.reachability.search)
        grasp = np.repeat(looked_at, [len(one) for one in found])
        configurations = np.concatenate([*found, np.empty((0, IIWA_7.joints))])
        psi = np.array([arm_angle_kernel(_CHAIN, one) for one in configurations])
        branch = np.array([branch_kernel(_CHAIN, one) for one in configurations], dtype=np.int64)
        free, of_grasp = np.zeros((2, len(psi))), X_OG[grasp]
        return self._items(of_grasp, grasp, branch, psi, free[0], free[1], X_WO)

    def _ranked(self, old: _Items, new: _Items, q: Array, relevant: float) -> tuple[_Items, int]:
        """The solutions that stay, best first, and how many of them are there to stay.

        The best one of each grasp comes first. Beyond the number that is kept, and without a grasp,
        only those remain that count now; they leave slowly.
        """
        items = _Items._make(np.concatenate(pair) for pair in zip(old, new, strict=True))
        way = _apart(items.q, q)
        order = np.argsort(way + np.minimum(items.target, 1e3), kind="stable")
        _, first = np.unique(items.grasp[order], return_index=True)
        later = np.ones(len(order), dtype=bool)
        later[first] = False
        order = order[np.argsort(later | (items.grasp[order] < 0), kind="stable")]
        counts = (way + items.cost < relevant) & (np.arange(len(way)) < len(old.q))
        counts, offered = counts[order], items.grasp[order] >= 0
        stays = counts | offered
        most = self.options.n_solutions
        stays[most:] = counts[most:]
        n_kept = int(stays[:most].sum())
        return _Items._make(each[order[stays]] for each in items), n_kept


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
