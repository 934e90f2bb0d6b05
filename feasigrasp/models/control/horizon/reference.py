"""Reference of a plan: joint positions and velocities that lead to the selected grasp in time.

Before the interception the joints follow the cubic of time of least squared acceleration, from
their present state to that of the interception. From there on, and where the joints are near it
anyway, they follow the closed-form solution of the grasp at the object's predicted poses, pulled
back by the approach corridor, at fixed branch and arm angle.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.continuation import flange_pose_kernel, solve_kernel, stand_behind_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

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
def reference_kernel(
    X_WH,
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
    X_GF,
    near,
    q_ref,
    v_ref,
    share,
):
    """Writes the reference ``q_ref``, ``v_ref`` (N, 7), and shares (N,) of the standoff kept.

    ``X_WH`` (N, 4, 4) are the hand's poses in the plan at ``times`` (N,), ``X_WO`` the object's
    then, ``X_WO_after`` those `INSTANT` later; q, v (7,) is the state of the arm, and in ``left``
    seconds it is to be that of the interception. Of the standoff less is kept where a joint limit
    is in the way.
    """
    n, margin, intercepts = IIWA_7.joints, IIWA_7.position_margin, True
    X_WF, solution, after = np.empty((4, 4)), np.empty(n), np.empty(n)
    for k in range(len(times)):
        X_OH = compose_kernel(inverse_kernel(X_WO[k]), X_WH[k])
        standoff = standoff_kernel(X_OG, X_OH, corridor)
        back, reached = stand_behind_kernel(
            X_OG, standoff, X_WO[k], X_GF, branch, psi, margin, X_WF, solution
        )
        share[k] = back / standoff if standoff > 0.0 else 1.0
        reached = reached and inside_limits_kernel(solution, margin)
        if k == 0:
            intercepts = not (reached and np.max(np.abs(solution - q)) < near)
        flange_pose_kernel(X_WO_after[k], X_OG, back, X_GF, X_WF)
        moves = reached and solve_kernel(X_WF, branch, psi, after)
        for j in range(n):
            q_ref[k, j], v_ref[k, j] = q_there[j], 0.0
            if intercepts and times[k] < left:
                way, v_ref[k, j] = _interpolated(
                    q_there[j] - q[j], v[j], v_there[j], left, times[k]
                )
                q_ref[k, j] = q[j] + way
            elif reached:
                q_ref[k, j] = solution[j]
                v_ref[k, j] = (after[j] - solution[j]) / INSTANT if moves else 0.0
        if np.max(np.abs(v_ref[k]) / IIWA_7.velocity_limits) > _TOO_FAST:
            v_ref[k] = 0.0
