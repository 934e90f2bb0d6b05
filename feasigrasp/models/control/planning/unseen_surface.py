"""Surface that nobody has seen gives way to a hand that is lined up with a grasp in it.

A field closes a shape where no camera has looked: a bowl seen from below is full. Grasps whose hand
collides with nothing but such surface are offered if a network believes in them
(`feasigrasp.models.grasps.hand_clearance`). A hand that kept off it all the same would hover before
the rim for ever.
"""

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.grasps.funnel import grasp_errors

#: A hand no farther than this from its nearest grasp is on its way into it [m], [rad].
_NEAR, _LINED_UP = 0.12, 0.4
#: What a turn of the hand counts as, beside its way [m/rad].
_LEVER = 0.1


def kept_surface(grid: ObstacleGrid, X_OH: Array, X_OG: Array, hand: Array) -> ObstacleGrid:
    """The surface that a hand keeps off: what was seen of it, if its grasp is in the rest.

    Args:
        grid: All of the object's surface, in O.
        X_OH: Pose of the hand, shape (4, 4); NaN while that of the object is not known.
        X_OG: The grasps on offer, shape (n, 4, 4).
        hand: Points on the open hand, in G, shape (k, 3) [m].
    """
    if grid.seen is None or len(X_OG) == 0 or not np.isfinite(X_OH).all():
        return grid
    position, angle = grasp_errors(X_OG, X_OH).T
    nearest = np.argmin(position + _LEVER * angle)
    if position[nearest] > _NEAR or angle[nearest] > _LINED_UP:
        return grid
    R, p = X_OG[nearest, :3, :3], X_OG[nearest, :3, 3]
    distance, _ = grid.distance_and_gradient(hand @ R.T + p)
    return grid.seen if (distance < 0.0).any() else grid
