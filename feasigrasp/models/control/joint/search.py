"""Update of the IK solutions as grasps and object change.

Between two updates solutions move by themselves (`feasigrasp.models.control.joint.solutions`). An
update matches them with the grasps that are offered now, lets arm angles glide to where they cost
less, looks for new ones, and drops those that do not count. Nothing that counts appears or vanishes
at once: a new solution starts at a cost at which it has no influence, and costs change at a bounded
rate; one whose grasp is gone rises in cost until it has none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.control.horizon.distance_field import distances_kernel, length_scale_kernel
from feasigrasp.models.control.joint.judged import JudgedSolutions, judge_kernel
from feasigrasp.models.control.joint.options import SolutionOptions
from feasigrasp.models.control.joint.solutions import Solutions
from feasigrasp.models.ik.continuation import branch_kernel, flange_pose_kernel
from feasigrasp.models.control.planning.cost_weights import CostWeights
from feasigrasp.models.geometry import se3
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.models.ik.self_motion import arm_angle_kernel
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import forward_kinematics

#: A solution counts nothing if going there is longer than the best by this number of length scales.
#: Source: numerical.
IRRELEVANT = 12.0
#: Grasps whose solutions are looked for at one update, once some are known. Source: numerical.
GRASPS_AT_ONCE = 12
#: Grasps count as the same if no entry of their poses differs by more. Source: numerical.
SAME_GRASP = 1e-9
#: Largest rate of the length scale [rad/s]. Source: guessed.
_LENGTH_SCALE_RATE = 0.2


@dataclass(frozen=True, eq=False)
class SolutionSearch:
    """Keeps solutions up to date.

    Attributes:
        reachability: Limits, clearances and the hand.
        corridor: The way into a grasp.
        costs: What solutions cost.
        options: Which solutions are kept.
        period: Time between updates [s].
    """

    reachability: Reachability
    corridor: ApproachCorridor
    costs: CostWeights
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
            X_WO: Poses of the object at the instants of ``costs``, now first, shape (k, 4, 4).
            q: Joint positions [rad], shape (7,).
        """
        X_OG = grasps.X_OG
        angles, costs, scale = previous.at(min(max(time - previous.time, 0.0), self.period))
        grasp = matches(previous.X_OG, X_OG)
        rates = self.costs.grasp_rates(grasps)
        of_grasp = np.append(rates, 0.0)[grasp]  # 0 without a grasp, -1
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
        wanted = self.length_scale(items.q)
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

    def length_scale(self, q: Array) -> float:
        """The length scale of a field over configurations (n, 7), by their spacing [rad]."""
        r = np.empty((len(q), len(q)))
        distances_kernel(q, r)
        return float(length_scale_kernel(r))

    def flange_poses(self, X_OG: Array, X_WO: Array, q: Array) -> Array:
        """Flange poses (n, 4, 4) in the approach corridors, at the present misalignment."""
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
    ) -> JudgedSolutions:
        """Solutions with their configurations; cost: what it should be, if None."""
        n, X_FG = len(branch), self.reachability.gripper.X_FG
        standoffs = self._standoffs(X_OG, X_WO[0], q)
        configurations, reached = np.empty((n, IIWA_7.joints)), np.zeros(n, dtype=bool)
        target, better = np.zeros(n), np.zeros(n)
        judge_kernel(
            *(q, X_FG, X_WO, X_OG, grasp_rates, standoffs, branch, psi, self.costs.instants),
            *(self.reachability.search, self.costs.record),
            *(configurations, reached, target, better),
        )
        target *= self.options.radians_per_second
        cost = target.copy() if cost is None else cost
        return JudgedSolutions(
            X_OG, grasp, branch, psi, rate, cost, target, better, configurations, reached
        )

    def _new_items(
        self,
        old: JudgedSolutions,
        X_OG: Array,
        grasp_rates: Array,
        looked_at: Indices,
        X_WO: Array,
        q: Array,
    ) -> JudgedSolutions:
        """Solutions of some of the grasps that are apart from those there are."""
        X_WF = self.flange_poses(X_OG[looked_at], X_WO[0], q)
        found = self.options.find(
            X_WF,
            q,
            [old.q[old.grasp == g] for g in looked_at],
            self.options.per_grasp,
            self.reachability.search,
            self.costs,
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

    def _ranked(
        self, old: JudgedSolutions, new: JudgedSolutions, q: Array, relevant: float
    ) -> tuple[JudgedSolutions, int]:
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
        return np.array([standoff_kernel(X, X_OH, self.corridor.parameters) for X in X_OG])


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
