"""Joint velocity towards and along a candidate path, by weighted least squares.

On a candidate path the arm follows its reference. On the way there, the joint that takes longest
sets the duration: it moves at its speed limit, and every other joint need only be in time with it.
What is free meanwhile keeps the hand close to the object::

    min  sum_j w_j ((qd_j - qd*_j) / v_j)^2 + w_p ((n . J_p qd - v_n) / v_0)^2

with ``qd*`` the synchronised motion, ``w_j`` rising steeply with the share of the time that joint j
needs, n the direction from the hand to the object's middle, and ``v_n`` the speed along it that
leads the hand to a sphere about the object: as far from its middle as the way into the grasp asks
for at present. Along the sphere the hand is free, so that it goes round the object, not through it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from feasigrasp.models.arrays import Array, record
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.task.reference import CandidateReference
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel


@dataclass(frozen=True)
class PursuitOptions:
    """Gains and weights of the pursuit of a candidate.

    Attributes:
        gain: Rate at which the distance to the reference decreases [1/s].
        speed_share: Share of the joints' speed limits that is used for that.
        closeness: w_p, weight of keeping the hand on the sphere on the way.
        freedom: w_j of a joint that has all the time.
        urgency: w_j of the joint that takes longest.
        blend: Ways shorter than half of this are followed without regard to the object, ways
            longer than 1.5 times as much with full weight of it [s].
        speed: v_0, speed that leads the hand to the sphere at most [m/s].
    """

    gain: float = 6.0
    speed_share: float = 0.8
    closeness: float = 1.0
    freedom: float = 0.02
    urgency: float = 20.0
    blend: float = 0.6
    speed: float = 0.5

    @cached_property
    def record(self) -> NDArray[np.void]:
        """The options as a record for kernels."""
        return record(self)


def pursuit_velocity(
    q: Array,
    reference: CandidateReference,
    X_WO: Array,
    V_WO: Array,
    X_FG: Array,
    options: PursuitOptions,
) -> Array:
    """Joint velocity towards and along a candidate path, without position limits and clearance.

    Args:
        q: Joint positions [rad], shape (7,).
        reference: Reference configuration of the candidate.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        X_FG: Grasp frame on the flange, shape (4, 4).
        options: Gains and weights.

    Returns:
        Joint velocity [rad/s], shape (7,), inside the speed limits.
    """
    qd = np.empty(IIWA_7.joints)
    _pursue_kernel(
        np.ascontiguousarray(q, dtype=float),
        reference.q,
        reference.qd,
        reference.X_OT,
        np.ascontiguousarray(X_WO, dtype=float),
        np.ascontiguousarray(V_WO, dtype=float),
        X_FG,
        options.record,
        qd,
    )
    return qd


@compiled
def _pursue_kernel(q, q_ref, qd_ref, X_OT, X_WO, V_WO, X_FG, options, qd):
    o = options[0]
    time = 0.0
    for j in range(IIWA_7.joints):
        time = max(time, abs(q_ref[j] - q[j]) / (o.speed_share * IIWA_7.velocity_limits[j]))
    rate = min(o.gain, 1.0 / max(time, 1e-9))
    for j in range(IIWA_7.joints):
        qd[j] = rate * (q_ref[j] - q[j]) + qd_ref[j]
    part = o.closeness * min(1.0, max(0.0, time / o.blend - 0.5))
    if part > 0.0:
        X_WH, J = np.empty((4, 4)), np.empty((6, IIWA_7.joints))
        pose_jacobian_kernel(q, X_FG, X_WH, J)
        n, radius = np.empty(3), 0.0
        for i in range(3):
            n[i] = X_WO[i, 3] - X_WH[i, 3]
            radius += X_OT[i, 3] ** 2
        distance = max(float(np.sqrt(n @ n)), 1e-9)
        n /= distance
        inwards = min(max(o.gain * (distance - np.sqrt(radius)), -o.speed), o.speed) + n @ V_WO[3:]
        # Along the sphere the hand is free.
        row = n @ J[3:]
        H = (part / o.speed**2) * np.outer(row, row)
        f = (part / o.speed**2 * inwards) * row
        for j in range(IIWA_7.joints):
            needed = abs(q_ref[j] - q[j]) / (o.speed_share * IIWA_7.velocity_limits[j]) / time
            w = (o.freedom + o.urgency * needed**4) / IIWA_7.velocity_limits[j] ** 2
            H[j, j] += w
            f[j] += w * qd[j]
        qd[:] = np.linalg.solve(H, f)
    for j in range(IIWA_7.joints):
        qd[j] = min(max(qd[j], -IIWA_7.velocity_limits[j]), IIWA_7.velocity_limits[j])
