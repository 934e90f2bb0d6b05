"""Approach corridor: pre-grasp distance as a function of lateral and angular error.

A straight line to the grasp would sweep a finger through the object. Instead the hand follows the
grasp pose pulled back along its approach direction, by an amount that shrinks with the sideways and
angular error: the hand lines up first and slides in once it is lined up.
"""

from typing import NamedTuple

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled

#: Extra clearance to the object: this share of the hand's standoff, and at most this distance [m].
#: Source: guessed.
_SHARE, _MOST = 0.2, 0.01


class ApproachCorridor(NamedTuple):
    """Shape of the approach corridor.

    Attributes:
        max_standoff: Longest distance pulled back [m].
        lateral_gain: Standoff per sideways error beyond its tolerance [m/m].
        angular_gain: Standoff per angle error beyond its tolerance [m/rad].
        closing_tolerance: Error along the closing direction without standoff [m].
        width_tolerance: Error along the width of the fingers without standoff [m].
        angular_tolerance: Angle error without standoff [rad].
        min_standoff: Distance that is kept behind even where the hand has lined up [m].
    """

    max_standoff: float = 0.10
    lateral_gain: float = 4.0
    angular_gain: float = 0.3
    closing_tolerance: float = 0.008
    width_tolerance: float = 0.015
    angular_tolerance: float = 0.2
    min_standoff: float = 0.0

    @property
    def parameters(self) -> "ApproachCorridor":
        """The shape in floats: integers would compile the kernels anew."""
        return ApproachCorridor(*map(float, self))


@compiled
def _angle_between(X_OA, X_OB):
    """Angle of the rotation from one pose to another [rad]."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += X_OA[i, j] * X_OB[i, j]
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@compiled
def standoff_kernel(X_OG, X_OH, corridor):
    """Pre-grasp distance of hand H behind grasp G along its approach direction [m]."""
    px = py = 0.0
    for i in range(3):
        d = X_OH[i, 3] - X_OG[i, 3]
        px += X_OG[i, 0] * d
        py += X_OG[i, 1] * d
    x = max(0.0, abs(px) - corridor.closing_tolerance)
    y = max(0.0, abs(py) - corridor.width_tolerance)
    angle = max(0.0, _angle_between(X_OG, X_OH) - corridor.angular_tolerance)
    standoff = corridor.lateral_gain * np.hypot(x, y) + corridor.angular_gain * angle
    return max(corridor.min_standoff, min(corridor.max_standoff, standoff))


@compiled
def extra_clearance_kernel(X_OG, X_OH, corridor):
    """Distance beyond its clearance that a hand keeps off the object [m]: least for the grasps.

    It is zero once the hand has lined up with one of the grasps ``X_OG`` (n, 4, 4).
    """
    extra = _MOST
    for k in range(len(X_OG)):
        extra = min(extra, _SHARE * standoff_kernel(X_OG[k], X_OH, corridor))
    return extra


@compiled
def grasp_errors_kernel(X_OG, X_OH, errors):
    """Writes position [m] and angle [rad] error of the hand to every grasp, shape (n, 2)."""
    for k in range(len(X_OG)):
        square = 0.0
        for i in range(3):
            square += (X_OH[i, 3] - X_OG[k, i, 3]) ** 2
        errors[k, 0] = np.sqrt(square)
        errors[k, 1] = _angle_between(X_OG[k], X_OH)


def grasp_errors(X_OG: Array, X_OH: Array) -> Array:
    """Position [m] and angle [rad] error of the hand H to every grasp, shape (n, 2)."""
    errors = np.empty((len(X_OG), 2))
    grasp_errors_kernel(np.ascontiguousarray(X_OG), np.ascontiguousarray(X_OH), errors)
    return errors
