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
from feasigrasp.models.robot.arm import MARGIN, VELOCITY

#: Time over which the velocity of a solution is taken [s]. Source: guessed.
INSTANT = 0.01


@compiled
def _interpolated(way, v_0, v_1, duration, t):
    """Position and velocity at time t of the cubic that goes ``way`` from v_0 to v_1."""
    s, a, z = t / duration, duration * v_0, duration * v_1
    b, c = 3.0 * way - 2.0 * a - z, a + z - 2.0 * way
    return s * (a + s * (b + s * c)), (a + s * (2.0 * b + 3.0 * s * c)) / duration


@compiled
def reference_kernel(knots, grasps, meeting, corridor, X_GF, near, q_ref, v_ref):
    """Writes the reference ``q_ref``, ``v_ref`` (N, 7) to the first grasp, and ``knots.share``.

    Joints that are closer than ``near`` [rad] to it are not interpolated. Of the standoff less is
    kept where a joint limit is in the way.
    """
    n, chain, intercepts = knots.q.shape[1], knots.chain, True
    X_OG, branch, psi = grasps.X_OG[0], grasps.branch[0], grasps.psi[0]
    times, left, q_there = knots.times, meeting.left, meeting.q_there
    X_WF, solution, after = np.empty((4, 4)), meeting.q.copy(), np.empty(n)
    for k in range(len(times)):
        X_OH = compose_kernel(inverse_kernel(knots.X_WO[k]), knots.X_WH[k])
        standoff = standoff_kernel(X_OG, X_OH, corridor)
        back, reached = stand_behind_kernel(
            chain, X_OG, standoff, knots.X_WO[k], X_GF, branch, psi, X_WF, solution
        )
        knots.share[k] = back / standoff if standoff > 0.0 else 1.0
        reached = reached and inside_limits_kernel(chain, solution, chain[0, MARGIN])
        if k == 0:
            intercepts = not (reached and np.max(np.abs(solution - meeting.q)) < near)
        flange_pose_kernel(knots.X_WO_after[k], X_OG, back, X_GF, X_WF)
        after[:] = solution
        moves = reached and solve_kernel(chain, X_WF, branch, psi, after)
        for j in range(n):
            q_ref[k, j], v_ref[k, j] = q_there[j], 0.0
            if intercepts and times[k] < left:
                whole = q_there[j] - meeting.q[j]
                way, v_ref[k, j] = _interpolated(
                    whole, meeting.v[j], meeting.v_there[j], left, times[k]
                )
                q_ref[k, j] = meeting.q[j] + way
            elif reached:
                q_ref[k, j] = solution[j]
                v_ref[k, j] = (after[j] - solution[j]) / INSTANT if moves else 0.0
        # A solution so many times faster than the limits is next to a singularity; guessed.
        if np.max(np.abs(v_ref[k]) / chain[:n, VELOCITY]) > 3.0:
            v_ref[k] = 0.0
