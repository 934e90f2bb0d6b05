"""Inverse kinematics solutions of grasps with a fixed branch and arm angle while the object moves.

The closed form gives the configuration of a candidate (`feasigrasp.models.ik.continuation`) at its
arm angle anew at any pose of the object: the paper's "resample with the same seed" without a seed.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.continuation import (
    flange_pose_kernel,
    solve_kernel,
)
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

#: Time over which a velocity is taken [s]; its error is of the order of the squared angle that the
#: object turns meanwhile. Source: numerical.
_INSTANT = 1e-5
#: Solutions that count less than this are not fed forward. Source: numerical.
_NEGLIGIBLE = 1e-4


@dataclass(frozen=True, eq=False)
class Solutions(Frozen):
    """Grasps, each with a branch and an arm angle; costs are functions of the time since ``time``.

    Attributes:
        X_OG: Grasps in the object frame, shape (n, 4, 4) [m].
        branch: Branches ``4 elbow + 2 shoulder + wrist`` as in `closed_form`, shape (n,).
        arm_angle: Arm angles, shape (n,) [rad].
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
            *(np.zeros((0, 4, 4)), np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2))),
            np.array([0.1, 0.0]),
            time,
        )

    def at(self, elapsed: float) -> tuple[Array, float]:
        """Costs (n,) [rad] and length scale [rad] after a time [s]."""
        cost = self.cost[:, 0] + elapsed * self.cost[:, 1]
        return cost, float(self.length_scale[0] + elapsed * self.length_scale[1])


@compiled
def place_kernel(X_WO, X_OG, branch, arm_angle, X_GF, X_WF, q, index):
    """Writes the flange poses and configurations of all solutions that the arm may take.

    ``X_WF`` (n, 4, 4), ``q`` (n, 7) and ``index`` (n,), which solution each is, are filled from the
    front. Returns how many there are.
    """
    count = 0
    for i in range(len(branch)):
        flange_pose_kernel(X_WO, X_OG[i], 0.0, X_GF, X_WF[count])
        reached = solve_kernel(X_WF[count], branch[i], arm_angle[i], q[count])
        if reached and inside_limits_kernel(q[count], IIWA_7.position_margin):
            index[count] = i
            count += 1
    return count


@compiled
def candidate_velocity_kernel(X_WF, V_WO, p_WO, branch, psi, q, moved, qd):
    """Writes the velocity (7,) of a candidate at a flange pose; ``moved`` (4, 4) is scratch.

    The closed form's derivative along the twist at a fixed arm angle: the inverse of the Jacobian
    with the arm angle for a seventh row. False next to where it has none.
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
    if not solve_kernel(moved, branch, psi, qd):
        return False
    for k in range(IIWA_7.joints):
        qd[k] = (qd[k] - q[k]) / _INSTANT
        if not abs(qd[k]) < 100.0 * IIWA_7.velocity_limits[k]:
            return False
    return True


@compiled
def feed_forward_kernel(X_WF, V_WO, p_WO, branch, arm_angle, index, weights, q, qd):
    """Writes the mean velocity (7,) of the solutions that count."""
    moved, one = np.empty((4, 4)), np.empty(IIWA_7.joints)
    moved[3] = 0.0
    moved[3, 3] = 1.0
    qd[:] = 0.0
    for k in range(len(index)):
        if weights[k] > _NEGLIGIBLE:
            i = index[k]
            if candidate_velocity_kernel(
                X_WF[k], V_WO, p_WO, branch[i], arm_angle[i], q[k], moved, one
            ):
                for j in range(IIWA_7.joints):
                    qd[j] += weights[k] * one[j]
