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
from feasigrasp.models.robot.arm import MARGIN


@compiled
def distance_kernel(knots, grasps, corridor, X_GF, options, form):
    """Adds the quadratic forms of all knots; ``options`` are those of the program.

    A solution costs ``speed penalty`` [rad]. A knot at which no grasp has a solution adds nothing.
    """
    o, n, count = options[0], knots.q.shape[1], len(grasps.X_OG)
    X_WF, found, cost = np.empty((4, 4)), np.empty((count, n)), np.empty(count)
    gradient, part = np.empty(n), np.empty(count)
    for k in range(len(knots.q)):
        X_OH, m = compose_kernel(inverse_kernel(knots.X_WO[k]), knots.X_WH[k]), 0
        for i in range(count):
            back = knots.share[k] * standoff_kernel(grasps.X_OG[i], X_OH, corridor)
            flange_pose_kernel(knots.X_WO[k], grasps.X_OG[i], back, X_GF, X_WF)
            found[m] = knots.q[k]
            reached = solve_kernel(knots.chain, X_WF, grasps.branch[i], grasps.psi[i], found[m])
            margin = knots.chain[0, MARGIN]
            if reached and inside_limits_kernel(knots.chain, found[m], margin):
                cost[m] = o.speed * grasps.penalty[i]
                m += 1
        if m == 0:
            continue
        nodes, r, beta, lowest = found[:m], np.empty((m, m)), np.empty(m), np.empty(m)
        distances_kernel(nodes, r)
        length_scale = length_scale_kernel(r)
        fit_kernel(r, cost[:m], length_scale, NOISE_VARIANCE, lowest, beta)
        _, left = evaluate_kernel(knots.q[k], nodes, lowest, beta, length_scale, gradient, part[:m])
        for j in range(n):
            form.g[k, j] += o.distance * max(left, 0.0) * gradient[j]
            form.H[k, j, j] += o.distance
