"""How well an arm stands: distances to itself and to its limits, speed, manipulability."""

import numpy as np
from numba import njit

from feasigrasp.models.robot.capsule_kernels import distances_kernel
from feasigrasp.models.robot.collision_kernels import in_collision_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability_kernel


@njit(cache=True)
def arm_condition_kernel(q, v, model, all_pairs_model):
    """Five figures of one state of the arm.

    Args:
        q: Joint positions [rad], shape (7,).
        v: Joint velocities [rad/s], shape (7,).
        model: `CapsuleModel` with the pairs that can meet inside the joint limits.
        all_pairs_model: `CapsuleModel` with all pairs of bodies that are not neighbours.

    Returns:
        1 if any of all pairs penetrates, else 0; smallest distance of the pairs that can meet [m];
        smallest distance to a joint limit, negative beyond it [rad]; largest joint speed over its
        limit; manipulability sqrt(det J J^T).
    """
    collides = 1.0 if in_collision_kernel(q, all_pairs_model, 0.0) else 0.0
    distance = np.empty(len(model.pairs))
    distances_kernel(q, model, distance)
    margin, ratio = np.inf, 0.0
    for i in range(IIWA_7.joints):
        margin = min(margin, IIWA_7.position_limits[i] - abs(q[i]))
        ratio = max(ratio, abs(v[i]) / IIWA_7.velocity_limits[i])
    return collides, np.min(distance), margin, ratio, manipulability_kernel(q)
