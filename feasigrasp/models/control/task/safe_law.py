"""Task-space control over a Riemannian mixture of grasps (paper section IV-D.1).

The paper follows the gradient of the mixture's log density. `task_space_velocity` adds what keeps
the arm away from its limits:

- one grasp is followed at a time, together with the configuration that holds it; they are chosen
  with the object's future in view (`feasigrasp.models.control.task.choice`);
- near that configuration, or near its pose, the hand follows the geodesic into the grasp, back
  along the approach direction until it has lined up, and the redundant motion leads to the
  configuration;
- far from both the geodesic may lead against a limit, where the arm would stay: there the joints go
  to the configuration, and what is free meanwhile keeps the hand close to the object
  (`feasigrasp.models.control.task.pursuit`);
- farther still, if the object is quick and not in the way, they go to where that will be when it is
  due (`feasigrasp.models.control.task.safe_law`);
- a hand with the object between its fingers, but not for this grasp, steps back first, and one at
  the object that is too deep for its grasp goes back along its own axis before it turns;
- a QP keeps limits and clearances.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields
from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.planning.clearance_schedule import (
    is_close,
    retreat_velocity,
    scheduled_obstacle,
)
from feasigrasp.models.objects.predicted_poses import predicted_poses
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.control.task.choice import ChoiceOptions, GraspChoice
from feasigrasp.models.control.task.pursuit import PursuitOptions, pursuit_velocity
from feasigrasp.models.control.task.reference import candidate_reference
from feasigrasp.models.geometry import se3
from feasigrasp.models.geometry.obstacle_grid import ObstacleGrid
from feasigrasp.models.geometry.se3_kernels import compose_kernel, inverse_kernel, log_kernel
from feasigrasp.models.objects.prediction import Motion
from feasigrasp.models.quantities import Bound, NotNegative, Positive
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

# Interception of a candidate: there in time, with its velocity.
#
# An arm that runs after a quick object's grasp, wherever that is at the moment, turns as sharply as
# it does: it is at its acceleration limits all the time, and late. Where a grasp is due at a known
# time, the arm can go to where it will be, and arrive with its velocity. Of all ways there the
# cubic of time
#
#     q(0) = q,  q'(0) = v,  q(T) = q_T,  q'(T) = v_T
#
# has the least squared acceleration, added up over the way; it begins with
#
#     q''(0) = (6 (q_T - q) - T (4 v + 2 v_T)) / T^2
#
# and is begun anew at every tick, with what is known of the object by then.

#: Time over which the velocity of an object at a meeting is taken [s]. Source: numerical.
_INSTANT = 0.01


def object_at_interception(
    motion: Motion | None, X_WO: Array, V_WO: Array, left: float, options: ChoiceOptions
) -> tuple[Array, Array]:
    """Pose (4, 4) and twist (6,) [angular; linear] of the object at the interception time.

    Args:
        motion: What is known of its motion; without it the object keeps its twist at best.
        X_WO: Pose now, shape (4, 4).
        V_WO: Twist now, shape (6,).
        left: How long from now on [s].
        options: What the object is taken to do meanwhile.
    """
    times = np.array([left, left + _INSTANT])
    X, later = predicted_poses(options.prediction, motion, X_WO, V_WO, times)
    turn = se3.so3_log(later[:3, :3] @ X[:3, :3].T)
    return X, np.concatenate([turn, later[:3, 3] - X[:3, 3]]) / _INSTANT


def interception_velocity(
    q: Array, v: Array, q_meet: Array, v_meet: Array, left: float, period: float
) -> Array:
    """Joint velocity of the next tick (7,) [rad/s], on the way to an interception.

    Args:
        q: Positions now [rad], shape (7,).
        v: Velocities now [rad/s], shape (7,).
        q_meet: Positions at the meeting [rad], shape (7,).
        v_meet: Velocities there [rad/s], shape (7,).
        left: How long until then [s], positive.
        period: Between ticks [s].
    """
    return v + period * (6.0 * (q_meet - q) - left * (4.0 * v + 2.0 * v_meet)) / left**2


#: A hand at the object that is deeper than its target by this goes back rather than sideways or
#: round, and only back from twice as much on: otherwise it would be stopped by the object [m].
#: Source: guessed.
_DEEP = 0.02
#: A hand this close to the object's middle goes round it, wherever it is due [m]; one that is twice
#: as far away goes straight. Source: guessed.
_BESIDE = 0.15
#: An object up to this quick is run after, which keeps it in the camera's view; one that is twice
#: as quick is met [m/s]. Source: guessed.
_QUICK = 0.2
#: What is left of the way in this time is followed, not met; twice as long before, it is met [s].
#: Source: guessed.
_SOONEST = 0.15


@dataclass(frozen=True)
class TaskControlOptions:
    """Gains of the task-space controller.

    Attributes:
        gain: Rate at which the hand closes its distance to a grasp [1/s].
        max_linear: Largest speed relative to the object [m/s].
        max_angular: Largest angular speed relative to the object [rad/s].
        feed_forward: Whether the object's twist is added.
        near: Travel time to the chosen configuration, or of the hand to its pose, up to which the
            hand follows the geodesic [s]; from twice as much on the joints go there, and from three
            times as much on to where it will be.
        choice: Which grasp is followed, and in which configuration.
        pursuit: How the joints go to that configuration.
        safety: Margins of the QP.
    """

    gain: Positive = 5.0
    max_linear: Bound = 0.4
    max_angular: Bound = 1.5
    feed_forward: bool = True
    near: NotNegative = 0.2
    choice: ChoiceOptions = field(default_factory=ChoiceOptions)
    pursuit: PursuitOptions = field(default_factory=PursuitOptions)
    safety: SafetyOptions = field(default_factory=SafetyOptions)

    def __post_init__(self) -> None:
        """Checks the numbers.

        Raises:
            ControlError: A number is out of range.
        """
        check_fields(self, ControlError)

    @cached_property
    def gains(self) -> tuple[float, float, float]:
        """The numbers that the kernels take."""
        return self.gain, self.max_angular, self.max_linear


@compiled
def hand_twist_kernel(u_H, X_WH, X_WO, V_WO, max_angular, max_linear):
    """Twist of the hand in the world [angular; linear] from one relative to the object.

    ``u_H`` is the body twist relative to the object. It is shortened, direction kept, so that
    neither part is faster than its limit; then the twist is added that the hand would have if it
    were fixed to the object, whose twist at its own origin is ``V_WO``.
    """
    angular = np.sqrt(u_H[0] ** 2 + u_H[1] ** 2 + u_H[2] ** 2)
    linear = np.sqrt(u_H[3] ** 2 + u_H[4] ** 2 + u_H[5] ** 2)
    scale = 1.0 / max(1.0, angular / max_angular, linear / max_linear)
    V = np.empty(6)
    x, y, z = X_WH[0, 3] - X_WO[0, 3], X_WH[1, 3] - X_WO[1, 3], X_WH[2, 3] - X_WO[2, 3]
    wx, wy, wz = V_WO[0], V_WO[1], V_WO[2]
    V[0], V[1], V[2] = wx, wy, wz
    V[3] = V_WO[3] + wy * z - wz * y
    V[4] = V_WO[4] + wz * x - wx * z
    V[5] = V_WO[5] + wx * y - wy * x
    for i in range(3):
        for j in range(3):
            V[i] += scale * X_WH[i, j] * u_H[j]
            V[3 + i] += scale * X_WH[i, j] * u_H[3 + j]
    return V


@compiled
def _steer_kernel(q, X_FG, X_WO, V_WO, X_OT, gains, goes_back, J_WH):
    """Writes the hand's Jacobian (6, 7).

    Returns the twist (6,) that leads it to pose T, how far it is, at its largest speeds [s], and
    its distance to the object's middle [m].
    ``goes_back`` says whether a hand that is too deep goes back first.
    """
    gain, max_angular, max_linear = gains
    X_WH = np.empty((4, 4))
    pose_jacobian_kernel(q, X_FG, X_WH, J_WH)
    way = log_kernel(compose_kernel(inverse_kernel(compose_kernel(X_WO, X_OT)), X_WH))
    angle, length = np.sqrt(np.sum(way[:3] ** 2)), np.sqrt(np.sum(way[3:] ** 2))
    if goes_back:  # a body twist: its last component is along the hand's own axis
        way[:5] *= min(1.0, max(0.0, 1.0 - (way[5] - _DEEP) / _DEEP))
    twist = hand_twist_kernel(-gain * way, X_WH, X_WO, V_WO, max_angular, max_linear)
    apart = np.sqrt(np.sum((X_WH[:3, 3] - X_WO[:3, 3]) ** 2))
    return twist, max(angle / max_angular, length / max_linear), apart


def task_space_velocity(
    q: Array,
    choice: GraspChoice,
    X_WO: Array,
    V_WO: Array,
    reachability: Reachability,
    safety: SafetyFilter,
    options: TaskControlOptions,
    *,
    time: float = 0.0,
    motion: Motion | None = None,
    qd_last: Array | None = None,
    obstacles: ObstacleGrid | None = None,
    surface: ObstacleGrid | None = None,
) -> Array:
    """Joint velocity of the safe task-space controller.

    Args:
        q: Joint positions [rad], shape (7,).
        choice: The grasp to follow, and how; without one the arm stops.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Its gripper says where the hand is on the flange.
        safety: The QP, for the same gripper.
        options: Gains.
        time: Present time [s].
        motion: What is known of the object's motion.
        qd_last: The command of one period ago [rad/s], shape (7,); without it accelerations are
            not limited, and the arm goes for where the object is now.
        obstacles: What the arm must not touch.
        surface: Distances to the object's surface, in its frame, which the open hand keeps off.

    Returns:
        Joint velocity [rad/s], shape (7,), always finite: the arm also stops while pose or twist
        of the object is not.
    """
    X_FG, chosen = reachability.gripper.X_FG, [choice.X_OG] if choice else []
    moving = scheduled_obstacle(surface, q, X_WO, V_WO, X_FG, chosen, options.choice.corridor)
    if not options.feed_forward:
        V_WO = np.where(np.isfinite(V_WO), 0.0, V_WO)  # an unknown twist still stops the arm
    reference = candidate_reference(choice, time, q, X_WO, V_WO, reachability, options.choice)
    if reference is None:
        return safety.velocity(
            q, np.zeros(IIWA_7.joints), qd_last=qd_last, obstacles=obstacles, moving=moving
        )
    if moving is not None and moving.misaligned:
        return retreat_velocity(safety, q, X_FG, moving, qd_last=qd_last, obstacles=obstacles)
    J_WH = np.empty((6, IIWA_7.joints))
    V_WH, away, apart = _steer_kernel(
        np.ascontiguousarray(q, dtype=float),
        X_FG,
        X_WO,
        V_WO,
        reference.X_OT,
        options.gains,
        moving is not None and is_close(moving, q, X_FG),
        J_WH,
    )
    travel_time = np.max(np.abs(reference.q - q) / IIWA_7.velocity_limits)
    away = min(travel_time, away) if reference.on_candidate else travel_time
    far = max(0.0, away / options.near - 1.0)
    request = pursuit_velocity(q, reference, X_WO, V_WO, X_FG, options.pursuit)
    left = choice.interception_time - time
    quick = float(np.sqrt(np.sum(V_WO[3:] ** 2)))
    shares = (far, apart / _BESIDE, quick / _QUICK, left / _SOONEST)
    meets = min(min(shares) - 1.0, 1.0)
    if meets > 0.0 and qd_last is not None:
        interception = object_at_interception(motion, X_WO, V_WO, left, options.choice)
        goal = candidate_reference(
            choice, time, q, X_WO, V_WO, reachability, options.choice, interception=interception
        )
        if goal is not None:
            met = interception_velocity(q, qd_last, goal.q, goal.qd, left, options.safety.period)
            request += meets * (met - request)
    limited = partial(
        safety.velocity, q, request, qd_last=qd_last, obstacles=obstacles, moving=moving
    )
    if not reference.on_candidate or far >= 1.0:
        return limited()
    V_WH += far * (J_WH @ request - V_WH)
    return limited(J_WH, V_WH)
