"""The way into a grasp: along the approach direction, so that open fingers straddle the object.

A straight line to the grasp would sweep a finger through the object. Instead the hand follows the
grasp pose pulled back along its approach direction, by an amount that shrinks with the sideways and
angular error: the hand lines up first and slides in once it is lined up.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array
from feasigrasp.models.geometry.se3_kernels import inverse_kernel, log_kernel


@dataclass(frozen=True)
class Funnel:
    """Shape of the funnel.

    Attributes:
        max_standoff: Longest distance pulled back [m].
        lateral_gain: Standoff per sideways error beyond its tolerance [m/m].
        angular_gain: Standoff per angle error beyond its tolerance [m/rad].
        closing_tolerance: Error along the closing direction without standoff [m].
        width_tolerance: Error along the width of the fingers without standoff [m].
        angular_tolerance: Angle error without standoff [rad].
        closing_axis_share: What a turn about the closing direction counts as an angle error: the
            fingers stay beside the object, and only the palm goes round it.
    """

    max_standoff: float = 0.10
    lateral_gain: float = 4.0
    angular_gain: float = 0.3
    closing_tolerance: float = 0.008
    width_tolerance: float = 0.015
    angular_tolerance: float = 0.2
    closing_axis_share: float = 1.0

    @cached_property
    def parameters(self) -> Array:
        """The attributes in order, for the kernels."""
        return np.array(
            [
                self.max_standoff,
                self.lateral_gain,
                self.angular_gain,
                self.closing_tolerance,
                self.width_tolerance,
                self.angular_tolerance,
                self.closing_axis_share,
            ]
        )


@njit(cache=True)
def _angle_between(X_OA, X_OB):
    """Angle of the rotation from one pose to another [rad]."""
    trace = 0.0
    for i in range(3):
        for j in range(3):
            trace += X_OA[i, j] * X_OB[i, j]
    return np.arccos(min(1.0, max(-1.0, 0.5 * (trace - 1.0))))


@njit(cache=True)
def _closing_axis_factor(X_OA, X_OB, share):
    """By what the angle between poses shrinks if its part about the x-axis of A counts less."""
    x = y = z = 0.0
    for i in range(3):
        x += X_OA[i, 2] * X_OB[i, 1] - X_OA[i, 1] * X_OB[i, 2]
        y += X_OA[i, 0] * X_OB[i, 2] - X_OA[i, 2] * X_OB[i, 0]
        z += X_OA[i, 1] * X_OB[i, 0] - X_OA[i, 0] * X_OB[i, 1]
    across = y * y + z * z
    total = x * x + across
    return np.sqrt((share * share * x * x + across) / total) if total > 1e-12 else 1.0


@njit(cache=True)
def standoff_kernel(X_OG, X_OH, funnel):
    """How far hand H must stay behind grasp G along its approach direction [m]."""
    px = py = 0.0
    for i in range(3):
        d = X_OH[i, 3] - X_OG[i, 3]
        px += X_OG[i, 0] * d
        py += X_OG[i, 1] * d
    lateral = np.hypot(max(0.0, abs(px) - funnel[3]), max(0.0, abs(py) - funnel[4]))
    angle = _angle_between(X_OG, X_OH)
    if funnel[6] != 1.0:
        angle *= _closing_axis_factor(X_OG, X_OH, funnel[6])
    standoff = funnel[1] * lateral + funnel[2] * max(0.0, angle - funnel[5])
    return min(funnel[0], standoff)


@njit(cache=True)
def funnel_targets_kernel(X_OG, X_OH, funnel, targets):
    """Writes the poses (n, 4, 4) that a hand at ``X_OH`` should steer to on its way into grasps."""
    for k in range(len(X_OG)):
        standoff = standoff_kernel(X_OG[k], X_OH, funnel)
        targets[k] = X_OG[k]
        for i in range(3):
            targets[k, i, 3] -= standoff * X_OG[k, i, 2]


@njit(cache=True)
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


@njit(cache=True)
def steering_kernel(X_OG, X_OH, funnel, weight, u):
    """Writes the body twist (6,) that leads the hand along the geodesics into weighted grasps.

    ``u = -sum_i w_i log(target_i^-1 X_OH)`` with the funnel target of every grasp.
    """
    targets = np.empty((len(X_OG), 4, 4))
    funnel_targets_kernel(X_OG, X_OH, funnel, targets)
    u[:] = 0.0
    for k in range(len(X_OG)):
        u -= weight[k] * log_kernel(inverse_kernel(targets[k]) @ X_OH)


def funnel_targets(X_OG: Array, X_OH: Array, funnel: Funnel) -> Array:
    """Poses (n, 4, 4) that the hand H should steer to on its way into the grasps (n, 4, 4)."""
    targets = np.empty((len(X_OG), 4, 4))
    funnel_targets_kernel(
        np.ascontiguousarray(X_OG), np.ascontiguousarray(X_OH), funnel.parameters, targets
    )
    return targets
