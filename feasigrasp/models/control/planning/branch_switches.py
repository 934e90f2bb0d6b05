"""Branch switches: motions between grasp candidates, at the time of least total cost.

CandidateGraph, nodes and costs are those of `feasigrasp.models.control.planning.candidate_graph`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.candidate_graph import CandidateGraph
from feasigrasp.models.ik.continuation import stand_behind_kernel
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import ApproachCorridor, standoff_kernel
from feasigrasp.models.ik.self_motion import travel_time_kernel
from feasigrasp.models.reach.kernels import Search
from feasigrasp.models.robot.capsule_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Points at which a transfer is looked at on its way. Source: numerical.
_ON_THE_WAY = 3
#: No transfer keeps the hand closer to the object than this, on average [m]. Source: guessed.
_CLOSEST = 0.02
#: Added to the cost of a candidate that cannot be reached within the horizon. Source: numerical.
_LATE = 1e6


class BranchSwitch(NamedTuple):
    """The branch switch of least total cost onto a candidate.

    Attributes:
        cost: Of the way and of what follows, to the horizon [s]; infinite if there is none.
        grasp: Index of the grasp.
        branch: Branch.
        instant: When it is reached, index of the instant.
        angle: Index of the arm angle there.
    """

    cost: float
    grasp: int
    branch: int
    instant: int
    angle: int


#: No switch: its cost is infinite. Source: layout.
_NO_SWITCH = BranchSwitch(np.inf, -1, -1, -1, -1)


class Plan(NamedTuple):
    """The planning problem: candidates, predicted object poses and cost weights.

    Attributes:
        graph: All nodes.
        X_WO: Poses of the object at the instants, shape (K + 1, 4, 4).
        times: The instants, shape (K + 1,) [s].
        X_OG: The grasps, shape (n, 4, 4).
        X_FG: The grasp frame on the flange, shape (4, 4).
        corridor: Its shape.
        search: Limits and clearances.
        costs: `CostWeights`, as a record.
    """

    graph: CandidateGraph
    X_WO: Array
    times: Array
    X_OG: Array
    X_FG: Array
    corridor: ApproachCorridor
    search: Search
    costs: NDArray[np.void]


@compiled
def path_cost_kernel(q, node, k0, k, travel, X_WO, times, start, standoff, search, X_FG, costs):
    """Cost of the straight way from ``q`` at instant k0 to ``node`` at instant k.

    It is the mean distance of hand and object, ``start`` at first and ``standoff`` at last, for
    its duration ``travel``, and collisions. With k = k0 the object stays where it is.
    """
    total, hits = 0.5 * (start + standoff), 0
    on_way, X = np.empty(IIWA_7.joints), np.empty((4, 4))
    duration = times[k] - times[k0]
    for step in range(1, _ON_THE_WAY + 1):
        s = step / (_ON_THE_WAY + 1.0)
        on_way[:] = q + s * (node - q)
        pose_jacobian_kernel(on_way, X_FG, X, None)
        # The object meanwhile, between two instants.
        t = times[k0] + min(s * travel, duration)
        m = k0
        while m + 1 < k and times[m + 1] <= t:
            m += 1
        f = (t - times[m]) / (times[m + 1] - times[m]) if k > k0 else 0.0
        after = min(m + 1, len(times) - 1)
        square = 0.0
        for i in range(3):
            p = X_WO[m, i, 3] + f * (X_WO[after, i, 3] - X_WO[m, i, 3])
            square += (X[i, 3] - p) ** 2
        total += max(np.sqrt(square), (1.0 - abs(2.0 * s - 1.0)) * standoff)
        if not is_clear_kernel(on_way, search.capsules, 0.0, search.table_height):
            hits += 1
    return travel * total / ((_ON_THE_WAY + 1.0) * costs.lost) + costs.collision * hits


@compiled
def branch_switch_kernel(q, k0, last, only, skipped, plan):
    """The best `BranchSwitch` that leaves configuration ``q`` at instant ``k0``.

    It is over at the instant ``last`` at the latest.

    ``only`` and ``skipped`` are the grasp and branch of the one candidate that is considered, or of
    the one that is not; (-1, -1) for none.
    """
    best, costs = _NO_SWITCH, plan.costs[0]
    graph, X_WO, times, X_OG = plan.graph, plan.X_WO, plan.times, plan.X_OG
    K, n, P = len(times) - 1, len(X_OG), graph.rate.shape[3]
    X_WH, X_WF, behind = np.empty((4, 4)), np.empty((4, 4)), np.empty(IIWA_7.joints)
    X_GF = inverse_kernel(plan.X_FG)
    pose_jacobian_kernel(q, plan.X_FG, X_WH, None)
    X_OH = inverse_kernel(X_WO[k0]) @ X_WH
    start = np.sqrt(X_OH[0, 3] ** 2 + X_OH[1, 3] ** 2 + X_OH[2, 3] ** 2)
    shortest = np.inf
    for i in range(n):
        if only[0] >= 0 and i != only[0]:
            continue
        standoff = standoff_kernel(X_OG[i], X_OH, plan.corridor)
        overhead = costs.regrip_time * standoff / max(plan.corridor[0], 1e-9)
        for b in range(8):
            if (only[1] >= 0 and b != only[1]) or (i == skipped[0] and b == skipped[1]):
                continue
            for k in range(min(k0 + 1, last), last + 1):
                available = times[k] - times[k0]
                for j in range(P):
                    rate = graph.rate[k, i, b, j]
                    if rate == np.inf:
                        continue
                    node = graph.q[k, i, b, j]
                    motion = travel_time_kernel(q, node)
                    travel = motion / costs.speed_share + overhead
                    late = travel > available
                    if late and (k < K or (best.cost < np.inf and shortest <= travel)):
                        continue
                    wait = max(0.0, available - travel)
                    cost = graph.cost_to_go[k, i, b, j] + costs.motion * motion
                    cost += (rate + costs.waiting) * wait
                    if not late and cost + _CLOSEST / costs.lost * travel >= best.cost:
                        continue
                    if standoff > 0.0 and costs.no_corridor > 0.0:
                        psi, margin = plan.search.psis[j], plan.search.limit_margin
                        back, _ = stand_behind_kernel(
                            X_OG[i], standoff, X_WO[k], X_GF, b, psi, margin, X_WF, behind
                        )
                        cost += costs.no_corridor * (standoff - back) / plan.corridor.max_standoff
                    cost += path_cost_kernel(
                        *(q, node, k0, k, travel, X_WO, times, start, standoff),
                        *(plan.search, plan.X_FG, costs),
                    )
                    if late:  # only where nothing else is in time
                        if best.cost < _LATE:
                            continue
                        cost += _LATE
                        shortest = travel
                    if cost < best.cost:
                        best = BranchSwitch(cost, i, b, k, j)
    return best


@compiled
def remaining_cost_kernel(q, last, grasp, branch, plan):
    """Remaining cost of the present candidate, with the best later branch switch.

    The candidate is reached at the instant ``last`` at the latest.

    Returns the `BranchSwitch` onto the candidate, its cost that of the whole plan, and the instant
    at which it is left; -1 if not before the horizon.
    """
    graph, times = plan.graph, plan.times
    # Typed: for every constant among the arguments numba would compile another
    # branch_switch_kernel.
    now, no_candidate = np.int64(0), (np.int64(-1), np.int64(-1))
    K = np.int64(len(times) - 1)
    there = branch_switch_kernel(q, now, last, (grasp, branch), no_candidate, plan)
    if there.grasp < 0:
        return there, -1
    best, leave = there.cost, -1
    cost_to_go = graph.cost_to_go[there.instant, grasp, branch, there.angle]
    until = there.cost - cost_to_go  # cost until the instant that is looked at
    k, j = there.instant, there.angle
    while k < K:
        here = graph.q[k, grasp, branch, j]
        away = branch_switch_kernel(here, k, K, no_candidate, (grasp, branch), plan)
        if until + away.cost < best:
            best, leave = until + away.cost, k
        m = graph.successor[k, grasp, branch, j]
        if m < 0:
            break
        dt = times[k + 1] - times[k]
        rate = graph.rate[k, grasp, branch, j] + graph.rate[k + 1, grasp, branch, m]
        until += 0.5 * dt * rate
        k, j = k + 1, m
    return BranchSwitch(best, there.grasp, there.branch, there.instant, there.angle), leave
