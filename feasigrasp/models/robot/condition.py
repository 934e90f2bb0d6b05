"""How well an arm stands: distance to its limits, speed, manipulability."""

import numpy as np

from feasigrasp.models.compiled import compiled
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability_kernel


@compiled
def arm_condition_kernel(q, v):
    """Three figures of one state of the arm.

    Args:
        q: Joint positions [rad], shape (7,).
        v: Joint velocities [rad/s], shape (7,).

    Returns:
        Smallest distance to a joint limit, negative beyond it [rad]; largest joint speed over its
        limit; manipulability sqrt(det J J^T).
    """
    margin, ratio = np.inf, 0.0
    for i in range(IIWA_7.joints):
        margin = min(margin, IIWA_7.position_limits[i] - abs(q[i]))
        ratio = max(ratio, abs(v[i]) / IIWA_7.velocity_limits[i])
    return margin, ratio, manipulability_kernel(q)
