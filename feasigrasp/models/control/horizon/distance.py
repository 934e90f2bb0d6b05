"""Distance field over inverse kinematics solutions, along a plan (paper section IV-D.2).

The paper's law ``qd = -d grad d`` leads down the distance d of a Gaussian process to the solutions
of many grasps. Here its step is the target of every knot: the cost ``w / 2 d^2`` is bounded from
above by ``w / 2 |q - (q_0 - d grad d)|^2`` about the plan before, q_0, with the solutions of the
grasps near the selected one at the object's predicted pose.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.horizon.distance_field import (
    NOISE_VARIANCE,
    distances_kernel,
    evaluate_kernel,
    fit_kernel,
    length_scale_kernel,
)
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.robot.iiwa import IIWA_7


@compiled
def distance_kernel(Q, X_WH, X_WO, X_OG, branch, psi, penalty, share, corridor, X_GF, weight, H, g):
    """Adds the quadratic forms of all knots to Hessians H (N, 7, 7) and gradients g (N, 7).

    ``Q`` (N, 7) and ``X_WH`` (N, 4, 4) are the plan's positions and hand poses, ``X_WO``
    (N, 4, 4) the object's poses, ``X_OG`` (M, 4, 4) the grasps with branches, arm angles [rad] and
    penalties (M,) [rad]; ``share`` (N,) of the standoff is kept. A knot at which no grasp has a
    solution adds nothing.
    """
    n, count = IIWA_7.joints, len(X_OG)
    X_WF, found, cost = np.empty((4, 4)), np.empty((count, n)), np.empty(count)
    gradient, part = np.empty(n), np.empty(count)
    for k in range(len(Q)):
        X_OH, m = compose_kernel(inverse_kernel(X_WO[k]), X_WH[k]), 0
        for i in range(count):
            back = share[k] * standoff_kernel(X_OG[i], X_OH, corridor)
            flange_pose_kernel(X_WO[k], X_OG[i], back, X_GF, X_WF)
            reached = solve_kernel(X_WF, branch[i], psi[i], found[m])
            if reached and inside_limits_kernel(found[m], IIWA_7.position_margin):
                cost[m] = penalty[i]
                m += 1
        if m == 0:
            continue
        nodes, r, beta, lowest = found[:m], np.empty((m, m)), np.empty(m), np.empty(m)
        distances_kernel(nodes, r)
        length_scale = length_scale_kernel(r)
        fit_kernel(r, cost[:m], length_scale, NOISE_VARIANCE, lowest, beta)
        _, left = evaluate_kernel(Q[k], nodes, lowest, beta, length_scale, gradient, part[:m])
        for j in range(n):
            g[k, j] += weight * max(left, 0.0) * gradient[j]
            H[k, j, j] += weight
