"""The way to where a strand will be: there in time, and then as quick as it.

An arm that runs after a quick object's grasp, wherever that is at the moment, turns as sharply as
it does: it is at its acceleration limits all the time, and late. Where a grasp is due at a known
time, the arm can go to where it will be, and arrive with its velocity. Of all ways there the cubic
of time

    q(0) = q,  q'(0) = v,  q(T) = q_T,  q'(T) = v_T

has the least squared acceleration, added up over the way; it begins with

    q''(0) = (6 (q_T - q) - T (4 v + 2 v_T)) / T^2

and is begun anew at every tick, with what is known of the object by then.
"""

from __future__ import annotations

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.control.planning.outlook import poses_ahead
from feasigrasp.models.control.task.choice import ChoiceOptions
from feasigrasp.models.geometry import se3
from feasigrasp.models.objects.prediction import Motion

#: Time over which the velocity of an object at a meeting is taken [s].
_INSTANT = 0.01


def object_at_meeting(
    motion: Motion | None, X_WO: Array, V_WO: Array, left: float, options: ChoiceOptions
) -> tuple[Array, Array]:
    """Pose (4, 4) and twist (6,) [angular; linear] of the object in so much time.

    Args:
        motion: What is known of its motion; without it the object keeps its twist at best.
        X_WO: Pose now, shape (4, 4).
        V_WO: Twist now, shape (6,).
        left: How long from now on [s].
        options: What the object is taken to do meanwhile.
    """
    times = np.array([left, left + _INSTANT])
    X, later = poses_ahead(options.look_ahead, motion, X_WO, V_WO, times)
    turn = se3.so3_log(later[:3, :3] @ X[:3, :3].T)
    return X, np.concatenate([turn, later[:3, 3] - X[:3, 3]]) / _INSTANT


def meeting_velocity(
    q: Array, v: Array, q_meet: Array, v_meet: Array, left: float, period: float
) -> Array:
    """Joint velocity of the next tick (7,) [rad/s], on the way to a meeting.

    Args:
        q: Positions now [rad], shape (7,).
        v: Velocities now [rad/s], shape (7,).
        q_meet: Positions at the meeting [rad], shape (7,).
        v_meet: Velocities there [rad/s], shape (7,).
        left: How long until then [s], positive.
        period: Between ticks [s].
    """
    return v + period * (6.0 * (q_meet - q) - left * (4.0 * v + 2.0 * v_meet)) / left**2
