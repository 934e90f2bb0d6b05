"""What it will cost to be at a solution for the next seconds: limits, posture, end of the line.

A solution is continued with its arm angle along the predicted poses of the object. Meanwhile it
pays for joints near their limits, for low manipulability, and for a grasp far from the object's
middle; if it ends (out of reach, at a limit, in a collision), it pays the sooner the more.
Beside that, the straight way to it has a price: for the time that the hand is away from the object,
and for the arm in its own way. All costs
are in radians, as distances between configurations are: a solution that costs one less is worth
going one radian for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import njit

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.joint.solutions import flange_pose_kernel, solve_kernel
from feasigrasp.models.ik.closed_form import inside_limits_kernel, travel_time_kernel
from feasigrasp.models.robot.collision_kernels import is_clear_kernel
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import manipulability_kernel, pose_jacobian_kernel

_PARTS = 4


class Prices(NamedTuple):
    """The prices of an `Outlook`."""

    limit: float
    limit_share: float
    manipulability: float
    good_manipulability: float
    offset: float
    end: float
    way: float
    blocked: float


@dataclass(frozen=True)
class Outlook:
    """Prices [rad].

    Attributes:
        limit: Of a joint at its limit; nothing below ``limit_share`` of it.
        limit_share: Share of the range of a joint that is free.
        manipulability: Of a singular arm; nothing above ``good_manipulability``.
        good_manipulability: Manipulability from which on more is not better [m^3].
        offset: Of a grasp whose contact centre is away from the object's middle [rad/m].
        end: Of a solution that ends at once; falls with the square of the time left.
        way: Of the way there, per time that the hand is away from the object, times how far
            [rad/(m s)].
        blocked: Of a way that is in collision all along.
        horizon: How far ahead is looked if the object's motion is predicted [s].
        blind_horizon: How far if all that is known is its twist [s].
        instants: At how many poses of the object.
    """

    limit: float = 1.0
    limit_share: float = 0.75
    manipulability: float = 2.0
    good_manipulability: float = 0.13
    offset: float = 5.0
    end: float = 10.0
    way: float = 3.0
    blocked: float = 6.0
    horizon: float = 1.5
    blind_horizon: float = 1.0
    instants: int = 9

    @cached_property
    def prices(self) -> Prices:
        """What the kernels take."""
        return Prices(*(getattr(self, name) for name in Prices._fields))

    def times(self, predicted: bool) -> Array:
        """The instants that are looked at, shape (instants,) [s], now included."""
        horizon = self.horizon if predicted else self.blind_horizon
        return np.linspace(0.0, horizon, self.instants)

    @classmethod
    def free(cls) -> Outlook:
        """Nothing costs anything."""
        return cls(limit=0.0, manipulability=0.0, offset=0.0, end=0.0, way=0.0, instants=1)


@njit(cache=True)
def posture_cost_kernel(q, prices):
    """Cost of a configuration by itself: joints near limits, low manipulability."""
    cost = 0.0
    share = prices.limit_share
    for k in range(IIWA_7.joints):
        beyond = (abs(q[k]) / IIWA_7.position_limits[k] - share) / (1.0 - share)
        if beyond > 0.0:
            cost += prices.limit * beyond * beyond
    lack = 1.0 - manipulability_kernel(q) / prices.good_manipulability
    if lack > 0.0:
        cost += prices.manipulability * lack * lack
    return cost


@njit(cache=True)
def outlook_kernel(X_WO, X_OG, standoff, X_GF, branch, psi, search, prices, X_WF, q):
    """Cost [rad] of a solution along the object's poses (k, 4, 4); ``X_WF``, ``q`` are scratch."""
    n = len(X_WO)
    total, past = 0.0, 0
    for k in range(n):
        flange_pose_kernel(X_WO[k], X_OG, standoff, X_GF, X_WF)
        if not (
            solve_kernel(X_WF, branch, psi, q)
            and inside_limits_kernel(q, search.limit_margin)
            and is_clear_kernel(q, search.capsules, search.clearance, search.table_height)
        ):
            break
        total += posture_cost_kernel(q, prices)
        past += 1
    cost = total / max(past, 1)
    left = 1.0 - past / n
    cost += prices.end * left * left
    offset = np.sqrt(X_OG[0, 3] ** 2 + X_OG[1, 3] ** 2 + X_OG[2, 3] ** 2)
    return cost + prices.offset * offset


@njit(cache=True)
def way_cost_kernel(q, q_i, X_FG, p_WO, search, prices, scratch, X_WH):
    """What the straight way from ``q`` to ``q_i`` costs: its time, times how far the hand is off.

    The distance of hand and object is taken in the middle of each of ``_PARTS`` parts of the way,
    beyond what it is at its end; there it is also seen whether the arm collides.
    """
    if prices.way == 0.0:
        return 0.0
    pose_jacobian_kernel(q_i, X_FG, X_WH, None)
    at_end = _apart(X_WH, p_WO)
    mean, blocked = 0.0, 0
    for k in range(_PARTS):
        share = (k + 0.5) / _PARTS
        for j in range(IIWA_7.joints):
            scratch[j] = q[j] + share * (q_i[j] - q[j])
        pose_jacobian_kernel(scratch, X_FG, X_WH, None)
        mean += max(0.0, _apart(X_WH, p_WO) - at_end) / _PARTS
        if not is_clear_kernel(scratch, search.capsules, 0.0, search.table_height):
            blocked += 1
    return prices.way * mean * travel_time_kernel(q, q_i) + prices.blocked * blocked / _PARTS


@njit(cache=True)
def _apart(X_WH, p_WO):
    square = 0.0
    for k in range(3):
        square += (X_WH[k, 3] - p_WO[k]) ** 2
    return np.sqrt(square)
