"""How a hand on its way keeps off the object: the farther from lined up, the farther off.

With its least clearance alone it would slide round the object, a millimetre off, and touch what is
not quite where it is believed to be.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.safety.obstacle_grid import MovingObject, ObstacleGrid
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.funnel import Funnel, standoff_kernel
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: The reserve is this share of the hand's standoff, and at most so far [m].
_SHARE, _MOST = 0.2, 0.01


def kept_off(
    surface: ObstacleGrid | None,
    q: Array,
    X_WO: Array,
    V_WO: Array,
    X_FG: Array,
    X_OG: ArrayLike,
    funnel: Funnel,
) -> MovingObject | None:
    """The object as a hand keeps off it that goes for the nearest of some grasps.

    Args:
        surface: Distances to its surface, in O; None if it is not to be kept off.
        q: Joint positions [rad], shape (7,).
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        X_FG: Grasp frame on the flange, shape (4, 4).
        X_OG: The grasps, in O, shape (n, 4, 4).
        funnel: The way into a grasp.

    Returns:
        The object; its reserve is zero once the hand has lined up with a grasp.
    """
    if surface is None:
        return None
    reserve = _reserve_kernel(
        np.ascontiguousarray(q, dtype=float),
        X_FG,
        np.ascontiguousarray(X_WO, dtype=float),
        np.array(X_OG, dtype=float).reshape(-1, 4, 4),  # a copy: never read-only, of one type
        funnel.parameters,
    )
    return MovingObject(surface, X_WO, V_WO, reserve)


@njit(cache=True)
def _reserve_kernel(q, X_FG, X_WO, X_OG, funnel):
    X_WH, reserve = np.empty((4, 4)), _MOST
    pose_jacobian_kernel(q, X_FG, X_WH, None)
    X_OH = inverse_kernel(X_WO) @ X_WH
    for k in range(len(X_OG)):
        reserve = min(reserve, _SHARE * standoff_kernel(X_OG[k], X_OH, funnel))
    return reserve
