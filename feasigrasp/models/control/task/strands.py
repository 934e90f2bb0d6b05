"""Following grasps into the future: the strands that a choice is made from (see `choice`).

A *strand* is a grasp and an inverse-kinematics branch; a *node* of it is an arm angle at one of the
instants at which the object's pose is predicted. Costs are in metre-seconds: the distance of hand
and object, over time. What a strand costs from any of its nodes on follows by dynamic programming,
backwards in time, over steps that the joints' speed limits allow.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array, Indices
from feasigrasp.models.ik.arm_angle_table import lanes_kernel, travel_times_kernel
from feasigrasp.models.ik.arm_circle import arm_circle_kernel, configuration_kernel
from feasigrasp.models.ik.closed_form import inside_limits_kernel, travel_time_kernel
from feasigrasp.models.reach.kernels import REACHABLE, hand_verdict_kernel
from feasigrasp.models.robot.collision_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability_kernel

#: Distance of hand and object once a strand has ended [m].
_LOST = 0.1


class Costs(NamedTuple):
    """The prices of a plan: attributes of `feasigrasp.models.control.task.choice.ChoiceOptions`.

    ``standoff`` is the funnel's largest.
    """

    speed_share: float
    regrip_time: float
    standoff: float
    manipulability: float
    manipulability_weight: float
    limit_zone: float
    limit_weight: float
    end: float
    outlook: float
    collision: float
    motion: float
    waiting: float


class Strands(NamedTuple):
    """All nodes: instants K + 1, grasps n, branches 8, arm angles P.

    Attributes:
        q: Configurations, shape (K + 1, n, 8, P, 7) [rad].
        rate: Cost per second of being there, infinite where a node is not admissible [m].
        to_go: Least cost from there to the horizon, staying on the strand [m s].
        following: Arm angle at the next instant, -1 where the strand ends.
    """

    q: Array
    rate: Array
    to_go: Array
    following: Indices


@njit(cache=True)
def _rate(q, offset, costs):
    """What it costs per second to hold a grasp in a configuration."""
    lack = max(0.0, 1.0 - manipulability_kernel(q) / costs.manipulability)
    rate = offset + costs.manipulability_weight * lack
    for i in range(IIWA_7.joints):
        inside = (IIWA_7.position_limits[i] - abs(q[i])) / costs.limit_zone
        if inside < 1.0:
            rate += costs.limit_weight * (1.0 - inside) ** 2
    return rate


@njit(cache=True)
def _write_nodes(q, X_WF, offset, search, lanes, ends, costs, Q, rate):
    """Writes configurations (8, P, 7) of one grasp at one instant, and what they cost."""
    rate[:] = np.inf
    circle = arm_circle_kernel(X_WF)
    if not circle.reached or hand_verdict_kernel(X_WF, search, ends) != REACHABLE:
        return
    travel_times_kernel(circle, q, search.limit_margin, lanes)
    P = len(lanes.sine) // 2
    for lane in range(2 * P):
        elbow = lanes.elbow[lane]
        for row in range(4):
            if lanes.time[row, lane] == np.inf:
                continue
            branch = row if elbow > 0.0 else 4 + row
            node = Q[branch, lane % P]
            configuration_kernel(
                circle, elbow * lanes.sine[lane], elbow * lanes.cosine[lane], branch, node
            )
            if inside_limits_kernel(node, search.limit_margin) and is_clear_kernel(
                node, search.open, search.clearance, search.table_height
            ):
                rate[branch, lane % P] = _rate(node, offset, costs)


@njit(cache=True)
def _end_cost(q_before, q, dt, horizon, costs):
    """Cost of being at ``q`` when the plan ends, with the limits that the joints are going to."""
    time = np.inf
    for i in range(IIWA_7.joints):
        speed = (q[i] - q_before[i]) / dt
        room = IIWA_7.position_limits[i] - q[i] if speed > 0.0 else IIWA_7.position_limits[i] + q[i]
        time = min(time, room / max(abs(speed), 1e-9))
    return costs.end * max(0.0, 1.0 - (horizon + time) / costs.outlook)


@njit(cache=True)
def _go_backwards(strands, times, costs):
    """Writes ``to_go`` and ``following``."""
    K, n, P = len(times) - 1, strands.rate.shape[1], strands.rate.shape[3]
    to_go, following, rate = strands.to_go, strands.following, strands.rate
    to_go[K] = 0.0
    following[:] = -1
    for k in range(K - 1, -1, -1):
        dt = times[k + 1] - times[k]
        lost = costs.end * max(0.0, 1.0 - times[k] / costs.outlook)
        lost += _LOST * (times[K] - times[k])
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
                        q, q_next = strands.q[k, i, b, j], strands.q[k + 1, i, b, m]
                        travel = travel_time_kernel(q, q_next)
                        if travel > costs.speed_share * dt:
                            continue
                        cost = to_go[k + 1, i, b, m] + costs.motion * travel
                        cost += 0.5 * dt * (rate[k, i, b, j] + rate[k + 1, i, b, m])
                        if k == K - 1:
                            cost += _end_cost(q, q_next, dt, times[K], costs)
                        if cost < best:
                            best, following[k, i, b, j] = cost, m
                    to_go[k, i, b, j] = best if best < np.inf else lost


@njit(cache=True)
def strands_kernel(q, X_WO, times, X_OG, X_GF, search, costs):
    """The `Strands` of grasps (n, 4, 4) for an object at poses (K + 1, 4, 4)."""
    K, n, P = len(times) - 1, len(X_OG), len(search.psis)
    strands = Strands(
        np.empty((K + 1, n, 8, P, 7)),
        np.empty((K + 1, n, 8, P)),
        np.empty((K + 1, n, 8, P)),
        np.empty((K + 1, n, 8, P), dtype=np.int64),
    )
    lanes = lanes_kernel(search.psis, np.nan)
    ends = np.empty(search.fixed.shape)
    for i in range(n):
        X_OF = X_OG[i] @ X_GF
        offset = np.sqrt(X_OG[i, 0, 3] ** 2 + X_OG[i, 1, 3] ** 2 + X_OG[i, 2, 3] ** 2)
        for k in range(K + 1):
            X_WF, Q, rate = X_WO[k] @ X_OF, strands.q[k, i], strands.rate[k, i]
            _write_nodes(q, X_WF, offset, search, lanes, ends, costs, Q, rate)
    _go_backwards(strands, times, costs)
    return strands
