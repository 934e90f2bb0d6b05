"""Continuation of a configuration along the object path at fixed branch and redundancy.

A configuration is its flange pose, its *branch* (which of the solutions of the closed form) and its
*redundancy* (the arm angle psi of an S-R-S arm, the last joint of another with seven, nothing of
one with six). A grasp in the object frame with a branch is a *candidate*: at any pose of the object
the closed form gives its configuration at a redundancy anew, exact, and it moves as smoothly as
object and redundancy do. Of an arm without one, least squares take its place.
"""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.seeded import seed_of_kernel, seeded_kernel
from feasigrasp.models.ik.self_motion import (
    arm_angle_kernel,
    configuration_kernel,
    inside_limits_kernel,
    self_motion_kernel,
)
from feasigrasp.models.ik.subproblems import parallel_axes_kernel, shoulder_wrist_kernel
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.robot.arm import FAMILY, MARGIN, Family
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Families as kernels compare them.
_SRS, _PARALLEL, _SEEDED = (float(f) for f in (Family.SRS, Family.PARALLEL, Family.SEEDED))


@compiled(forceinline=True)
def is_srs(chain):
    """Whether an arm is S-R-S."""
    return chain[len(chain) - 1, FAMILY] == _SRS


@compiled(forceinline=True)
def is_seeded(chain):
    """Whether an arm has no closed form."""
    return chain[len(chain) - 1, FAMILY] == _SEEDED


@compiled
def other_kernel(chain, X_WF, branch, redundancy, q):
    """`solve_kernel` of an arm that is not S-R-S."""
    if chain[len(chain) - 1, FAMILY] == _PARALLEL:
        return parallel_axes_kernel(chain, X_WF, branch, q)
    if is_seeded(chain):
        return seeded_kernel(chain, X_WF, branch, redundancy, q)
    return shoulder_wrist_kernel(chain, X_WF, branch, redundancy, q)


@compiled
def redundancy_kernel(chain, q):
    """The redundancy of a configuration (n,) [rad]."""
    if is_srs(chain):
        return arm_angle_kernel(chain, q)
    return q[6] if len(q) > 6 else 0.0


@compiled
def branch_kernel(chain, q):
    """Branch of a configuration (n,): that with which `solve_kernel` gives it back."""
    if is_srs(chain):
        return 4 * (q[3] < 0.0) + 2 * (q[1] < 0.0) + 1 * (q[5] < 0.0)
    if is_seeded(chain):
        return seed_of_kernel(chain, q)
    X_WF, solution, best, nearest = np.empty((4, 4)), np.empty(len(q)), 0, np.inf
    pose_jacobian_kernel(chain, q, np.eye(4), X_WF, None)
    for branch in range(8):
        solution[:] = q
        if other_kernel(chain, X_WF, branch, redundancy_kernel(chain, q), solution):
            apart = np.max(np.abs(solution - q))
            if apart < nearest:
                best, nearest = branch, apart
    return best


@compiled(forceinline=True)
def flange_pose_kernel(X_WO, X_OG, standoff, X_GF, X_WF):
    """Writes the flange pose (4, 4) of a hand that keeps ``standoff`` [m] behind a grasp."""
    for i in range(3):
        for j in range(3):
            X_WF[i, j] = 0.0
        X_WF[i, 3] = X_WO[i, 3]
        X_WF[3, i] = 0.0
    X_WF[3, 3] = 1.0
    for k in range(3):
        # Column k of R_OG, and the origin of the hand in the object frame.
        g0, g1, g2 = X_OG[k, 0], X_OG[k, 1], X_OG[k, 2]
        p = X_OG[k, 3] - standoff * g2
        a0 = g0 * X_GF[0, 0] + g1 * X_GF[1, 0] + g2 * X_GF[2, 0]
        a1 = g0 * X_GF[0, 1] + g1 * X_GF[1, 1] + g2 * X_GF[2, 1]
        a2 = g0 * X_GF[0, 2] + g1 * X_GF[1, 2] + g2 * X_GF[2, 2]
        p += g0 * X_GF[0, 3] + g1 * X_GF[1, 3] + g2 * X_GF[2, 3]
        for i in range(3):
            w = X_WO[i, k]
            X_WF[i, 0] += w * a0
            X_WF[i, 1] += w * a1
            X_WF[i, 2] += w * a2
            X_WF[i, 3] += w * p


@compiled(forceinline=True)
def solve_kernel(chain, X_WF, branch, psi, q):
    """Writes the configuration (n,); False if there is none.

    Of angles that differ by whole turns it is that next to what ``q`` held, unless S-R-S.
    """
    if not is_srs(chain):
        return other_kernel(chain, X_WF, branch, psi, q)
    circle = self_motion_kernel(chain, X_WF)
    if not circle.reached:
        return False
    s, c = fast_sincos(psi)
    configuration_kernel(circle, s, c, branch, q)
    return True


@compiled
def stand_behind_kernel(chain, X_OG, standoff, X_WO, X_GF, branch, psi, X_WF, q):
    """Writes flange pose (4, 4) and configuration (n,) of a hand behind a grasp.

    It stands back by the standoff [m], or by less where a joint limit does not allow more. Returns
    how far it is back, and whether it is in reach.
    """
    back, reached, steps = 0.0, False, 4
    for step in range(steps + 1):
        back = standoff * (1.0 - step / steps)
        flange_pose_kernel(X_WO, X_OG, back, X_GF, X_WF)
        reached = solve_kernel(chain, X_WF, branch, psi, q)
        if reached and inside_limits_kernel(chain, q, chain[0, MARGIN]):
            break
    return back, reached
