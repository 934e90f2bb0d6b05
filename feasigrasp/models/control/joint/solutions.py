"""IK solutions of many grasps with a fixed branch and arm angle while the object moves.

A solution here is a candidate (`feasigrasp.models.ik.continuation`) with its arm
angle: the closed form gives its configuration anew at any pose of the object. That is the paper's
"resample with the same seed" without a seed. Arm angles and costs change as smooth functions of
time, from one update to the next.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from feasigrasp.models.arrays import Array, Frozen, Indices
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.continuation import (
    candidate_velocity_kernel,
    flange_pose_kernel,
    solve_kernel,
)
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.self_motion import inside_limits_kernel
from feasigrasp.models.robot.iiwa import IIWA_7

#: Solutions that count less than this are not fed forward. Source: numerical.
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


@compiled
def place_kernel(X_WO, X_OH, X_OG, branch, angles, corridor, X_GF, X_WF, q, index):
    """Writes the flange poses and configurations of all solutions that the arm may take.

    ``X_WF`` (n, 4, 4), ``q`` (n, 7) and ``index`` (n,), which solution each is, are filled from the
    front. Returns how many there are.
    """
    count = 0
    for i in range(len(branch)):
        standoff = standoff_kernel(X_OG[i], X_OH, corridor)
        flange_pose_kernel(X_WO, X_OG[i], standoff, X_GF, X_WF[count])
        reached = solve_kernel(X_WF[count], branch[i], angles[i, 0], q[count])
        if reached and inside_limits_kernel(q[count], IIWA_7.position_margin):
            index[count] = i
            count += 1
    return count


@compiled
def feed_forward_kernel(X_WF, V_WO, p_WO, branch, angles, index, weights, q, most, qd):
    """Writes the mean velocity (7,) of the solutions that count.

    It is shortened to ``most`` times the joints' velocity limits, direction kept.
    """
    moved, one = np.empty((4, 4)), np.empty(IIWA_7.joints)
    moved[3] = 0.0
    moved[3, 3] = 1.0
    qd[:] = 0.0
    for k in range(len(index)):
        if weights[k] > _NEGLIGIBLE:
            i = index[k]
            if candidate_velocity_kernel(
                X_WF[k], V_WO, p_WO, branch[i], angles[i, 0], angles[i, 1], q[k], moved, one
            ):
                for j in range(IIWA_7.joints):
                    qd[j] += weights[k] * one[j]
    excess = 1.0
    for j in range(IIWA_7.joints):
        excess = max(excess, abs(qd[j]) / (most * IIWA_7.velocity_limits[j]))
    for j in range(IIWA_7.joints):
        qd[j] /= excess
