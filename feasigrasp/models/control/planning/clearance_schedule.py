"""Clearance schedule: distance of the hand to the object as a function of its misalignment.

With its least clearance alone it would slide round the object, a millimetre off, and touch what is
not quite at its estimated pose. And a hand that has the object between its fingers, but not
for any grasp that it goes for, cannot turn round it: it has to step back first.
"""

import numpy as np
from numpy.typing import ArrayLike

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.geometry.obstacle_grid import MovingObject, ObstacleGrid, grid_kernel
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import (
    ApproachCorridor,
    extra_clearance_kernel,
    grasp_errors,
    grasp_errors_kernel,
)
from feasigrasp.models.robot.arm import Arm
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

# Unobserved surface gives way to a hand that is lined up with a grasp in it.
#
# A field closes a shape where no camera has looked: a bowl seen from below is full. Grasps whose
# hand collides with nothing but such surface are offered if a network accepts them
# (`feasigrasp.models.grasps.hand_clearance`). A hand that kept off it all the same would hover
# before the rim for ever.

#: A hand no farther than this from its nearest grasp is on its way into it [m], [rad]. Source:
#: guessed.
_NEAR, _LINED_UP = 0.12, 0.4
#: What a turn of the hand counts as, beside its way [m/rad]. Source: guessed.
LEVER = 0.1


def obstacle_surface(grid: ObstacleGrid, X_OH: Array, X_OG: Array, hand: Array) -> ObstacleGrid:
    """The part of the object's ``grid``, in O, that the hand keeps off.

    Only what was observed of it, if the open hand, with points ``hand`` (k, 3) in G [m], is on its
    way into a grasp of ``X_OG`` (n, 4, 4) inside the rest. Its pose ``X_OH`` (4, 4) is NaN while
    that of the object is not known.
    """
    if grid.seen is None or len(X_OG) == 0 or not np.isfinite(X_OH).all():
        return grid
    position, angle = grasp_errors(X_OG, X_OH).T
    nearest = np.argmin(position + LEVER * angle)
    if position[nearest] > _NEAR or angle[nearest] > _LINED_UP:
        return grid
    R, p = X_OG[nearest, :3, :3], X_OG[nearest, :3, 3]
    distance, _ = grid.distance_and_gradient(hand @ R.T + p)
    return grid.seen if (distance < 0.0).any() else grid


#: Nearer than this to the middle between its pads, the object is between the fingers [m]; a hand
#: that is turned by more from each of its grasps is not there for any of them [rad]. Source:
#: guessed.
_BETWEEN, _MISALIGNED = 0.015, 1.6


def scheduled_obstacle(
    surface: ObstacleGrid | None,
    q: Array,
    X_WO: Array,
    V_WO: Array,
    X_FG: Array,
    X_OG: ArrayLike,
    corridor: ApproachCorridor,
    arm: Arm = IIWA_7,
) -> MovingObject | None:
    """The object as moving obstacle, with the clearance schedule of the nearest grasp.

    The reserve is zero once the hand has lined up with a grasp, and the hand is misaligned with the
    object between its fingers for none of them.

    Args:
        surface: Distances to its surface, in O; None if it is not to be kept off.
        q: Joint positions [rad], shape (7,).
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        X_FG: Grasp frame on the flange, shape (4, 4).
        X_OG: The grasps, in O, shape (n, 4, 4).
        corridor: The approach corridor.
        arm: The arm.
    """
    if surface is None:
        return None
    extra_clearance, misaligned = _schedule_kernel(
        arm.chain,
        np.ascontiguousarray(q, dtype=float),
        X_FG,
        np.ascontiguousarray(X_WO, dtype=float),
        np.array(X_OG, dtype=float).reshape(-1, 4, 4),  # a copy: never read-only, of one type
        corridor.parameters,
        surface.values,
        surface.frame,
    )
    return MovingObject(surface, X_WO, V_WO, extra_clearance, misaligned)


def step_back(X_WH: Array, X_WO: Array, V_WO: Array) -> Array:
    """Twist (6,) of a hand at X_WH (4, 4) that leaves an object with twist V_WO (6,) backwards."""
    lever, speed = X_WH[:3, 3] - X_WO[:3, 3], 0.15  # [m/s]; guessed
    linear = V_WO[3:] + np.cross(V_WO[:3], lever) - speed * X_WH[:3, 2]
    return np.concatenate([V_WO[:3], linear])


@compiled
def _schedule_kernel(chain, q, X_FG, X_WO, X_OG, corridor, values, frame):
    """The reserve [m], and whether the object is between the fingers for none of the grasps."""
    X_WH = np.empty((4, 4))
    pose_jacobian_kernel(chain, q, X_FG, X_WH, None)
    X_OH = inverse_kernel(X_WO) @ X_WH
    extra_clearance = extra_clearance_kernel(X_OG, X_OH, corridor)
    middle = X_OH[0, 3], X_OH[1, 3], X_OH[2, 3]
    if len(X_OG) == 0 or grid_kernel(middle, values, frame)[0] > _BETWEEN:
        return extra_clearance, False
    errors = np.empty((len(X_OG), 2))
    grasp_errors_kernel(X_OG, X_OH, errors)
    return extra_clearance, errors[:, 1].min() > _MISALIGNED
