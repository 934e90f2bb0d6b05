"""Surface that nobody has seen gives way to a hand that is lined up with a grasp in it.

A field closes a shape where no camera has looked: a bowl seen from below is full. Grasps whose hand
collides with nothing but such surface are offered if a network believes in them
(`feasigrasp.models.grasps.hand_clearance`). A hand that kept off it all the same would hover before
the rim for ever.
"""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.obstacle_grid import ObstacleGrid, grid_kernel
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.funnel import grasp_errors_kernel
from feasigrasp.models.robot.kinematics import forward_kinematics

#: A hand no farther than this from its nearest grasp is on its way into it [m], [rad].
_NEAR, _LINED_UP = 0.12, 0.4
#: What a turn of the hand counts as, beside its way [m/rad].
_LEVER = 0.1


def kept_surface(
    grid: ObstacleGrid, q: Array, X_FG: Array, X_WO: Array, X_OG: ArrayLike, hand: Array
) -> ObstacleGrid:
    """The surface that a hand keeps off: what was seen of it, if its grasp is in the rest.

    Args:
        grid: All of the object's surface, in O.
        q: Joint positions [rad], shape (7,).
        X_FG: Grasp frame on the flange, shape (4, 4).
        X_WO: Object pose, shape (4, 4).
        X_OG: The grasps on offer, in O, shape (n, 4, 4).
        hand: Points on the open hand, in G, shape (k, 3) [m].
    """
    grasps = np.array(X_OG, dtype=float).reshape(-1, 4, 4)
    if grid.seen is None or len(grasps) == 0 or not np.isfinite(X_WO).all():
        return grid
    X_OH = inverse_kernel(np.ascontiguousarray(X_WO, dtype=float)) @ forward_kinematics(q, X_FG)
    return grid.seen if _in_surface_kernel(grasps, X_OH, hand, grid.values, grid.frame) else grid


@njit(cache=True)
def _in_surface_kernel(X_OG, X_OH, hand, values, frame):
    """Whether the hand is on its way into a grasp at which some point of it is in the surface."""
    errors = np.empty((len(X_OG), 2))
    grasp_errors_kernel(X_OG, X_OH, errors)
    nearest = np.argmin(errors[:, 0] + _LEVER * errors[:, 1])
    if errors[nearest, 0] > _NEAR or errors[nearest, 1] > _LINED_UP:
        return False
    X = X_OG[nearest]
    for k in range(len(hand)):
        x = hand[k]
        p = (
            X[0, 0] * x[0] + X[0, 1] * x[1] + X[0, 2] * x[2] + X[0, 3],
            X[1, 0] * x[0] + X[1, 1] * x[1] + X[1, 2] * x[2] + X[1, 3],
            X[2, 0] * x[0] + X[2, 1] * x[1] + X[2, 2] * x[2] + X[2, 3],
        )
        if grid_kernel(p, values, frame)[0] < 0.0:
            return True
    return False
