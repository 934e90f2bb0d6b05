"""Gauss-Newton cost of a plan: errors of hand and joints to a grasp on the predicted path.

At each knot the hand goes for the grasp at the object's predicted pose, pulled back by the approach
corridor, and the joints for its closed-form solution at fixed branch and arm angle. Before the
interception the joints follow the cubic of time of least squared acceleration instead, from their
present state to that of the interception. The weight of the hand's pose is that of a Student's t::

    W / (1 + |e_p|^2 / k_p^2 + |e_r|^2 / k_r^2)
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.continuation import (
    flange_pose_kernel,
    solve_kernel,
    stand_behind_kernel,
)
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel, so3_log_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Time over which the velocity of a solution is taken [s]. Source: guessed.
INSTANT = 0.01
#: A solution this many times faster than the velocity limits is next to a singularity. Source:
#: guessed.
_TOO_FAST = 3.0


@compiled
def _interpolated(way, v_0, v_1, duration, t):
    """Position and velocity at time t of the cubic that goes ``way`` from v_0 to v_1."""
    s, a, z = t / duration, duration * v_0, duration * v_1
    b, c = 3.0 * way - 2.0 * a - z, a + z - 2.0 * way
    return s * (a + s * (b + s * c)), (a + s * (2.0 * b + 3.0 * s * c)) / duration


@compiled
def cost_kernel(
    Q,
    times,
    X_WO,
    X_WO_after,
    X_OG,
    branch,
    psi,
    q,
    v,
    left,
    q_there,
    v_there,
    corridor,
    X_FG,
    options,
    H,
    g,
    v_ref,
):
    """Writes Hessians H (N, 7, 7), gradients g (N, 7) and velocities of the reference (N, 7).

    ``Q`` (N, 7) are positions of the plan at ``times`` (N,), ``X_WO`` (N, 4, 4) the object's poses
    then, ``X_WO_after`` those `INSTANT` later; q, v (7,) is the state of the arm, and in ``left``
    seconds it is to be that of the interception.
    """
    o, n = options[0], IIWA_7.joints
    X_GF, X, J, W = inverse_kernel(X_FG), np.empty((4, 4)), np.empty((6, n)), np.empty(6)
    X_WF, X_OT, e = np.empty((4, 4)), X_OG.copy(), np.empty(6)
    solution, after, q_ref = np.empty(n), np.empty(n), np.empty(n)
    margin, intercepts = IIWA_7.position_margin, True
    for k in range(len(Q)):
        pose_jacobian_kernel(Q[k], X_FG, X, J)
        X_OH = compose_kernel(inverse_kernel(X_WO[k]), X)
        standoff = standoff_kernel(X_OG, X_OH, corridor)
        back, reached = stand_behind_kernel(
            X_OG, standoff, X_WO[k], X_GF, branch, psi, margin, X_WF, solution
        )
        reached = reached and inside_limits_kernel(solution, margin)
        if k == 0:
            intercepts = not (reached and np.max(np.abs(solution - q)) < o.near)
        flange_pose_kernel(X_WO_after[k], X_OG, back, X_GF, X_WF)
        moves = reached and solve_kernel(X_WF, branch, psi, after)
        for j in range(n):
            q_ref[j], v_ref[k, j] = q_there[j], 0.0
            if intercepts and times[k] < left:
                way, v_ref[k, j] = _interpolated(
                    q_there[j] - q[j], v[j], v_there[j], left, times[k]
                )
                q_ref[j] = q[j] + way
            elif reached:
                q_ref[j] = solution[j]
                v_ref[k, j] = (after[j] - solution[j]) / INSTANT if moves else 0.0
        if np.max(np.abs(v_ref[k]) / IIWA_7.velocity_limits) > _TOO_FAST:
            v_ref[k] = 0.0
        for i in range(3):
            X_OT[i, 3] = X_OG[i, 3] - back * X_OG[i, 2]
        X_WT = compose_kernel(X_WO[k], X_OT)
        e[:3] = so3_log_kernel(compose_kernel(X, inverse_kernel(X_WT))[:3, :3])
        e[3:] = X[:3, 3] - X_WT[:3, 3]
        tail = 1.0 + np.sum(e[3:] ** 2) / o.kernel_position**2
        tail += np.sum(e[:3] ** 2) / o.kernel_angle**2
        W[:3], W[3:] = o.rotation / tail, o.position / tail
        for j in range(n):
            g[k, j] = o.joint * (Q[k, j] - q_ref[j])
            for a in range(6):
                g[k, j] += J[a, j] * W[a] * e[a]
            for i in range(n):
                H[k, j, i] = o.joint if i == j else 0.0
                for a in range(6):
                    H[k, j, i] += J[a, j] * W[a] * J[a, i]
