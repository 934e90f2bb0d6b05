"""Cost-to-go of grasp candidates on the predicted path, by dynamic programming (Bellman 1957).

A *candidate* is a grasp and an inverse-kinematics branch; a *node* of it is an arm angle at one of
the instants at which the object's pose is predicted. The cost-to-go from any of its nodes follows
by dynamic programming, backwards in time, over steps that the joints' speed limits allow. A
candidate that keeps one arm angle has a cost of its own, which is a continuous function of that.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.control.planning.cost_weights import (
    running_cost_kernel,
    terminal_cost_kernel,
)
from feasigrasp.models.ik.redundancy import redundancy_samples_kernel, travel_times_kernel
from feasigrasp.models.ik.self_motion import (
    configuration_kernel,
    inside_limits_kernel,
    self_motion_kernel,
    travel_time_kernel,
)
from feasigrasp.models.reach.kernels import REACHABLE, hand_verdict_kernel
from feasigrasp.models.robot.capsule_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7


class CandidateGraph(NamedTuple):
    """All nodes: instants K + 1, grasps n, branches 8, arm angles P.

    Attributes:
        q: Configurations, shape (K + 1, n, 8, P, IIWA_7.joints) [rad].
        rate: Cost per second of being there, infinite where a node is not admissible.
        cost_to_go: Least cost from there to the horizon, staying on the candidate [s].
        successor: Arm angle at the next instant, -1 where the candidate path ends.
    """

    q: Array
    rate: Array
    cost_to_go: Array
    successor: Indices


@compiled
def _write_nodes(q, X_WF, grasp_rate, search, samples, ends, costs, Q, rate):
    """Writes configurations (8, P, 7) of one grasp at one instant, and what they cost."""
    rate[:] = np.inf
    circle = self_motion_kernel(X_WF)
    if not circle.reached or hand_verdict_kernel(X_WF, search, ends) != REACHABLE:
        return
    travel_times_kernel(circle, q, search.limit_margin, samples)
    P = len(samples.sine) // 2
    for sample in range(2 * P):
        elbow = samples.elbow[sample]
        for row in range(4):
            if samples.time[row, sample] == np.inf:
                continue
            branch = row if elbow > 0.0 else 4 + row
            node = Q[branch, sample % P]
            configuration_kernel(
                circle, elbow * samples.sine[sample], elbow * samples.cosine[sample], branch, node
            )
            if inside_limits_kernel(node, search.limit_margin) and is_clear_kernel(
                node, search.open, search.clearance, search.floor
            ):
                rate[branch, sample % P] = running_cost_kernel(node, grasp_rate, costs)


@compiled
def _cost_beyond_horizon(q_before, q, dt, horizon, costs):
    """Terminal cost of a path that ends beyond the horizon, at the joints' position limits."""
    time = np.inf
    for i in range(IIWA_7.joints):
        speed = (q[i] - q_before[i]) / dt
        room = IIWA_7.position_limits[i] - q[i] if speed > 0.0 else IIWA_7.position_limits[i] + q[i]
        time = min(time, room / max(abs(speed), 1e-9))
    return terminal_cost_kernel(horizon + time, costs)


@compiled
def _backward_pass(graph, times, costs):
    """Writes ``cost_to_go`` and ``successor``."""
    K, n, P = len(times) - 1, graph.rate.shape[1], graph.rate.shape[3]
    cost_to_go, successor, rate = graph.cost_to_go, graph.successor, graph.rate
    cost_to_go[K] = 0.0
    successor[:] = -1
    for k in range(K - 1, -1, -1):
        dt = times[k + 1] - times[k]
        lost = terminal_cost_kernel(times[k], costs) + times[K] - times[k]
        for i in range(n):
            for b in range(8):
                for j in range(P):
                    if rate[k, i, b, j] == np.inf:
                        continue
                    best = np.inf
                    for step in range(-1, 2):
                        m = (j + step) % P
                        if rate[k + 1, i, b, m] == np.inf:
                            continue
                        q, q_next = graph.q[k, i, b, j], graph.q[k + 1, i, b, m]
                        travel = travel_time_kernel(q, q_next)
                        if travel > costs.follow_share * dt:
                            continue
                        cost = cost_to_go[k + 1, i, b, m] + costs.motion * travel
                        cost += 0.5 * dt * (rate[k, i, b, j] + rate[k + 1, i, b, m])
                        if k == K - 1:
                            cost += _cost_beyond_horizon(q, q_next, dt, times[K], costs)
                        if cost < best:
                            best, successor[k, i, b, j] = cost, m
                    cost_to_go[k, i, b, j] = best if best < np.inf else lost


@compiled
def candidate_graph_kernel(q, X_WO, times, X_OG, grasp_rates, X_GF, search, costs):
    """The `CandidateGraph` of grasps (n, 4, 4) for an object at poses (K + 1, 4, 4).

    ``grasp_rates`` (n,) is what a second at each costs by itself.
    """
    K, n, P = len(times) - 1, len(X_OG), len(search.psis)
    graph = CandidateGraph(
        np.empty((K + 1, n, 8, P, IIWA_7.joints)),
        np.empty((K + 1, n, 8, P)),
        np.empty((K + 1, n, 8, P)),
        np.empty((K + 1, n, 8, P), dtype=np.int64),
    )
    samples = redundancy_samples_kernel(search.psis, np.nan)
    ends = np.empty(search.fixed.shape)
    for i in range(n):
        X_OF = X_OG[i] @ X_GF
        for k in range(K + 1):
            X_WF, Q, rate = X_WO[k] @ X_OF, graph.q[k, i], graph.rate[k, i]
            _write_nodes(q, X_WF, grasp_rates[i], search, samples, ends, costs[0], Q, rate)
    _backward_pass(graph, times, costs[0])
    return graph


@compiled
def candidate_cost_kernel(
    X_WO, times, X_OG, grasp_rate, standoff, X_GF, branch, psi, search, costs, X_WF, q
):
    """Cost of a candidate at a fixed arm angle; ``X_WF`` (4, 4) and ``q`` (7,) are scratch.

    It is followed along the object's poses ``X_WO`` (k, 4, 4), ``standoff`` behind its grasp.
    """
    n, past, rates = len(X_WO), 0, 0.0
    for k in range(n):
        flange_pose_kernel(X_WO[k], X_OG, standoff, X_GF, X_WF)
        if not (
            solve_kernel(X_WF, branch, psi, q)
            and inside_limits_kernel(q, search.limit_margin)
            and is_clear_kernel(q, search.capsules, search.clearance, search.floor)
        ):
            break
        rates += running_cost_kernel(q, grasp_rate, costs)
        past += 1
    horizon = times[n - 1]
    return horizon * rates / max(past, 1) + terminal_cost_kernel(horizon * past / n, costs)
