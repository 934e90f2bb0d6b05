"""Visibility constraint: keeps the object in the image of the wrist camera.

The object's middle is to stay inside a cone about the camera's axis, in which most of the object is
in the image; the cone is wider where the object is near and large: at a grasp only a part of it can
be seen, and its middle may be far aside. It is wider for a quick object, too, which an arm that has
to keep it in the middle of its image as well cannot follow. With the angle ``a`` that is left to
the cone's edge the velocity is the one nearest to what is wanted with ``a' >= -g a``; outside the
cone, it leads back.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.arm import VELOCITY, Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: Half of the cone's opening, and the share that is added of what the object's apparent radius is
#: larger than that of one as far away as it is first seen [rad]. Source: guessed.
_HALF_OPENING, _OF_RADIUS, _FAR_RADIUS = np.deg2rad(22.0), 0.8, np.deg2rad(18.0)
#: From the first speed on the cone is wider, at the second by this half [m/s, rad]. Source:
#: guessed.
_QUICK, _QUICKEST, _WIDER = 0.3, 0.5, np.deg2rad(12.0)
#: g, the rate at which the edge may be approached [1/s]. Source: guessed.
_RATE = 3.0
#: No faster than this does the object come back from outside the cone [rad/s]. Source: guessed.
_FASTEST = 1.0


def velocity_in_view(
    qd: Array,
    q: Array,
    X_FG: Array,
    X_WC: Array,
    p_W: Array,
    v_W: Array,
    radius: float,
    arm: Arm = IIWA_7,
) -> Array:
    """The velocity (7,) [rad/s] nearest to the wanted ``qd`` with which the object stays in view.

    It is ``qd`` where that does no harm, or if anything is not finite.

    Args:
        qd: Joint velocity that is wanted [rad/s], shape (7,).
        q: Joint positions [rad], shape (7,).
        X_FG: Grasp frame on the flange, shape (4, 4).
        X_WC: Pose of the camera, which is on the hand, z forward, shape (4, 4).
        p_W: The object's middle, shape (3,) [m].
        v_W: Its velocity, shape (3,) [m/s].
        radius: Of the object [m].
        arm: The arm.
    """
    kept = np.array(qd, dtype=float)
    _keep_kernel(
        arm.chain,
        np.array(q, dtype=float),
        np.array(X_FG, dtype=float, order="C"),
        np.array(X_WC, dtype=float, order="C"),
        np.array(p_W, dtype=float),
        np.array(v_W, dtype=float),
        float(radius),
        kept,
    )
    return kept


@compiled
def _room_kernel(cosine, apparent, speed):
    """Angle from an object's middle to the edge of the cone; negative outside."""
    angle = np.arccos(min(max(cosine, -1.0), 1.0))
    larger = np.arcsin(min(1.0, apparent)) - _FAR_RADIUS
    wider = min(max((speed - _QUICK) / (_QUICKEST - _QUICK), 0.0), 1.0) * _WIDER
    return _HALF_OPENING + wider + _OF_RADIUS * max(larger, 0.0) - angle


@compiled
def _keep_kernel(chain, q, X_FG, X_WC, p_W, v_W, radius, qd):
    """Writes the velocity (7,) in place of the one that is wanted."""
    X_WH, J = np.empty((4, 4)), np.empty((6, len(q)))
    pose_jacobian_kernel(chain, q, X_FG, X_WH, J)
    p_WC, z = X_WC[:3, 3].copy(), X_WC[:3, 2].copy()
    to = p_W - p_WC
    distance = np.sqrt(to @ to)
    n = to / max(distance, 1e-6)
    across = np.cross(n, z)
    sine = np.sqrt(across @ across)
    if not sine > 1e-3:  # on the camera's axis there is no direction to move in
        return
    room = _room_kernel(n @ z, radius / distance, np.sqrt(v_W @ v_W))
    axis = across / sine
    # The angle decreases by a turn of z towards n, and as n moves towards z ...
    towards = np.cross(axis, n) / distance
    # ... and the object looks larger as it comes nearer.
    if np.sin(_FAR_RADIUS) * distance < radius < distance:
        towards -= _OF_RADIUS * radius / (distance * np.sqrt(distance**2 - radius**2)) * n
    row, square, rate = np.empty(len(q)), 0.0, towards @ v_W
    for j in range(len(q)):
        w, v = J[:3, j].copy(), J[3:, j].copy()
        v += np.cross(w, p_WC - X_WH[:3, 3])
        row[j] = -(axis @ w) - towards @ v
        square += (row[j] * chain[j, VELOCITY]) ** 2
        rate += row[j] * qd[j]
    lack = min(-_RATE * room, _FASTEST) - rate
    if lack > 0.0 and square > 1e-9:
        # Nearest in units of the joints' speed limits.
        for j in range(len(q)):
            qd[j] += lack / square * row[j] * chain[j, VELOCITY] ** 2
