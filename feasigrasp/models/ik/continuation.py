"""Continuation of a configuration along the object path at fixed branch and arm angle.

A configuration of the iiwa is its flange pose, its *branch* (the signs of joints 2, 4 and 6) and
its *arm angle*. A grasp in the object frame with a branch is a *candidate*: at any pose of the
object the closed form gives its configuration at an arm angle anew, exact, and it moves as smoothly
as object and arm angle do.
"""

from __future__ import annotations

from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.self_motion import (
    configuration_kernel,
    inside_limits_kernel,
    self_motion_kernel,
)
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.robot.arm import MARGIN

#: Number of steps that shorten the way back from a grasp until no limit is in the way. Source:
#: numerical.
_BACKS = 4


@compiled(forceinline=True)
def branch_kernel(q):
    """Branch ``4 elbow + 2 shoulder + wrist`` of a configuration (7,)."""
    return 4 * (q[3] < 0.0) + 2 * (q[1] < 0.0) + 1 * (q[5] < 0.0)


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
    """Writes the configuration (7,); False if the wrist is out of reach."""
    circle = self_motion_kernel(chain, X_WF)
    if not circle.reached:
        return False
    s, c = fast_sincos(psi)
    configuration_kernel(circle, s, c, branch, q)
    return True


@compiled
def stand_behind_kernel(chain, X_OG, standoff, X_WO, X_GF, branch, psi, X_WF, q):
    """Writes flange pose (4, 4) and configuration (7,) of a hand behind a grasp.

    It stands back by the standoff [m], or by less where a joint limit does not allow more. Returns
    how far it is back, and whether it is in reach.
    """
    back, reached = 0.0, False
    for step in range(_BACKS + 1):
        back = standoff * (1.0 - step / _BACKS)
        flange_pose_kernel(X_WO, X_OG, back, X_GF, X_WF)
        reached = solve_kernel(chain, X_WF, branch, psi, q)
        if reached and inside_limits_kernel(chain, q, chain[0, MARGIN]):
            break
    return back, reached
