"""Inverse-kinematics solutions of many grasps that keep their identity while the object moves.

A configuration of the iiwa is its flange pose, its branch (the signs of joints 2, 4 and 6) and its
arm angle. A solution here is a grasp in the object frame, a branch and an arm angle: at any pose of
the object the closed form gives its configuration anew, exact, and it moves as smoothly as the
object does. That is the paper's "resample with the same seed" without a seed. Arm angles and costs
change as smooth functions of time, from one update to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.grasps.funnel import standoff_kernel
from feasigrasp.models.ik.arm_circle import arm_circle_kernel, configuration_kernel
from feasigrasp.models.ik.closed_form import inside_limits_kernel
from feasigrasp.models.numerics.fast_math import fast_sincos
from feasigrasp.models.robot.iiwa import IIWA_7

#: Time over which a solution's velocity is taken [s]; its error is of the order of the squared
#: angle that the object turns meanwhile.
_INSTANT = 1e-5
#: Solutions that count less than this are not fed forward.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, eq=False)
class Solutions(Frozen):
    """Grasps, each with a branch and an arm angle, as functions of the time since ``time``.

    Attributes:
        X_OG: Grasps in the object frame, shape (n, 4, 4) [m].
        branch: Branches ``4 elbow + 2 shoulder + wrist`` as in `closed_form`, shape (n,).
        arm_angle: Arm angle, its rate and its acceleration, shape (n, 3) [rad, rad/s, rad/s^2].
        cost: Cost and its rate, shape (n, 2) [rad, rad/s].
        length_scale: Length scale of the field and its rate [rad, rad/s], shape (2,).
        time: When they were updated [s].
        turn: Which grasp is looked at next, in a round of all.
    """

    X_OG: Array
    branch: Indices
    arm_angle: Array
    cost: Array
    length_scale: Array
    time: float = 0.0
    turn: int = 0

    def __post_init__(self) -> None:
        """Makes contiguous arrays."""
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                dtype = np.int64 if f.name == "branch" else np.float64
                object.__setattr__(self, f.name, np.ascontiguousarray(value, dtype=dtype))

    def __len__(self) -> int:
        """Number of solutions."""
        return len(self.branch)

    @classmethod
    def empty(cls, time: float = 0.0) -> Solutions:
        """No grasp can be reached."""
        return cls(
            np.zeros((0, 4, 4)),
            np.zeros(0, dtype=np.int64),
            np.zeros((0, 3)),
            np.zeros((0, 2)),
            np.array([0.1, 0.0]),
            time=time,
        )

    def at(self, elapsed: float) -> tuple[Array, Array, float]:
        """Arm angles with rates (n, 2), costs (n,) and length scale after a time [s]."""
        psi, rate, acceleration = self.arm_angle.T
        angles = np.column_stack(
            [psi + elapsed * (rate + 0.5 * elapsed * acceleration), rate + elapsed * acceleration]
        )
        return (
            angles,
            self.cost[:, 0] + elapsed * self.cost[:, 1],
            float(self.length_scale[0] + elapsed * self.length_scale[1]),
        )


def branches_of(q: Array) -> Indices:
    """Branches ``4 elbow + 2 shoulder + wrist`` of configurations (n, 7), shape (n,)."""
    negative = q[:, [5, 1, 3]] < 0.0
    return np.asarray(negative @ np.array([1, 2, 4]), dtype=np.int64)


@njit(cache=True, forceinline=True)
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


@njit(cache=True, forceinline=True)
def solve_kernel(X_WF, branch, psi, q):
    """Writes the configuration (7,); False if the wrist is out of reach."""
    circle = arm_circle_kernel(X_WF)
    if not circle.reached:
        return False
    s, c = fast_sincos(psi)
    configuration_kernel(circle, s, c, branch, q)
    return True


@njit(cache=True)
def place_kernel(X_WO, X_OH, X_OG, branch, angles, funnel, X_GF, X_WF, q, index):
    """Writes the flange poses and configurations of all solutions inside the joint limits.

    ``X_WF`` (n, 4, 4), ``q`` (n, 7) and ``index`` (n,), which solution each is, are filled from the
    front. Returns how many there are.
    """
    count = 0
    for i in range(len(branch)):
        standoff = standoff_kernel(X_OG[i], X_OH, funnel)
        flange_pose_kernel(X_WO, X_OG[i], standoff, X_GF, X_WF[count])
        reached = solve_kernel(X_WF[count], branch[i], angles[i, 0], q[count])
        if reached and inside_limits_kernel(q[count], 0.0):
            index[count] = i
            count += 1
    return count


@njit(cache=True)
def solution_velocity_kernel(X_WF, V_WO, p_WO, branch, psi, psi_rate, q, moved, qd):
    """Writes the velocity (7,) of a solution whose target moves with the object.

    The closed form's derivative along the twist and the arm angle: the inverse of the Jacobian with
    the arm angle for a seventh row. False, and nothing written, next to where it has none.
    """
    wx, wy, wz = V_WO[0], V_WO[1], V_WO[2]
    for j in range(4):
        x, y, z = X_WF[0, j], X_WF[1, j], X_WF[2, j]
        if j == 3:
            x, y, z = x - p_WO[0], y - p_WO[1], z - p_WO[2]
        moved[0, j] = X_WF[0, j] + _INSTANT * (wy * z - wz * y)
        moved[1, j] = X_WF[1, j] + _INSTANT * (wz * x - wx * z)
        moved[2, j] = X_WF[2, j] + _INSTANT * (wx * y - wy * x)
    for i in range(3):
        moved[i, 3] += _INSTANT * V_WO[3 + i]
    if not solve_kernel(moved, branch, psi + _INSTANT * psi_rate, qd):
        return False
    for k in range(IIWA_7.joints):
        qd[k] = (qd[k] - q[k]) / _INSTANT
        if not abs(qd[k]) < 100.0 * IIWA_7.velocity_limits[k]:
            return False
    return True


@njit(cache=True)
def feed_forward_kernel(X_WF, V_WO, p_WO, branch, angles, index, weights, q, qd):
    """Writes the mean velocity (7,) of the solutions that count, no faster than the joints are."""
    moved, one = np.empty((4, 4)), np.empty(IIWA_7.joints)
    moved[3] = 0.0
    moved[3, 3] = 1.0
    qd[:] = 0.0
    for k in range(len(index)):
        if weights[k] > _NEGLIGIBLE:
            i = index[k]
            if solution_velocity_kernel(
                X_WF[k], V_WO, p_WO, branch[i], angles[i, 0], angles[i, 1], q[k], moved, one
            ):
                for j in range(IIWA_7.joints):
                    qd[j] += weights[k] * one[j]
    excess = 1.0
    for j in range(IIWA_7.joints):
        excess = max(excess, abs(qd[j]) / IIWA_7.velocity_limits[j])
    for j in range(IIWA_7.joints):
        qd[j] /= excess
