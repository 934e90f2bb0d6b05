"""Cost of IK solutions at an update, and the arm angle of lower cost nearby."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array, Indices, Mask
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.branch_switches import path_cost_kernel
from feasigrasp.models.control.planning.candidate_graph import candidate_cost_kernel
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel, travel_time_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Step of arm angle at which costs are compared [rad]; how far their lowest point may be away, in
#: steps; and the least that they count as bent between them [s]. Source: guessed, numerical,
#: numerical.
_STEP, _MOST_STEPS, _LEAST_BEND = 0.08, 4.0, 1e-3


class JudgedSolutions(NamedTuple):
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

    def select(self, which: Mask | Indices) -> JudgedSolutions:
        """The solutions at the given indices."""
        return JudgedSolutions._make(array[which] for array in self)

    def with_others(self, others: JudgedSolutions) -> JudgedSolutions:
        """Concatenation of two sets of solutions."""
        return JudgedSolutions._make(
            np.concatenate(pair) for pair in zip(self, others, strict=True)
        )


@compiled
def judge_kernel(
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
    costs,
    q,
    reached,
    cost,
    better,
):
    """Writes configuration, cost [s] and step to the better arm angle, of every solution.

    ``X_WO`` (k, 4, 4) are the object's poses at ``times`` from now on. Beside what it costs to be
    there, which is the candidate's cost, the way there costs what the hand is farther away
    meanwhile. Without a horizon nothing costs anything.
    """
    X_WF, scratch, values, weights = (
        np.empty((4, 4)),
        np.empty(IIWA_7.joints),
        np.empty(3),
        costs[0],
    )
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
            values[j] = candidate_cost_kernel(
                *(X_WO, times, X_OG[i], grasp_rates[i], standoffs[i], X_GF),
                *(branch[i], psi[i] + (j - 1) * _STEP, search, weights, X_WF, scratch),
            )
        travel = travel_time_kernel(q_now, q[i]) / weights.speed_share
        way = path_cost_kernel(
            *(q_now, q[i], 0, 0, travel, X_WO, times, start, standoffs[i], search, X_FG, weights)
        )
        cost[i] = values[1] + max(0.0, way - travel * np.linalg.norm(X_OG[i, :3, 3]) / weights.lost)
        # To the lowest point of the parabola through the three, a few steps at most.
        bend = max(values[2] - 2.0 * values[1] + values[0], _LEAST_BEND)
        steps = 0.5 * (values[0] - values[2]) / bend
        better[i] = _STEP * min(max(steps, -_MOST_STEPS), _MOST_STEPS)
