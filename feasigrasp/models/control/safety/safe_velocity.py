"""Safety filter: the closest admissible joint velocity, by a small QP.

A controller asks for a twist of the hand, for a joint velocity, or for both; this solves::

    min   1/2 |W (J qd - V)|^2 + rho/2 |qd - qd_0|^2
    s.t.  lower(q, qd_last) <= qd <= upper(q, qd_last)      velocity, position and acceleration
          grad d_k(q) . qd >= -g (d_k - d_safe)             every close pair of bodies k

with the previous command ``qd_last``. Bodies are the arm's capsules, the hand's among them, a table
and the obstacles of a scene.

Why there is always an admissible velocity: slowing down all joints in the same proportion, by
``qd_last (1 - T/S)`` with the period T and the time ``S = max_i v_i/a_i`` in which the slowest
joint stops from full speed, keeps the acceleration limits; if ``g <= 1/S`` it also keeps every row
that held before, since then ``g d`` falls no faster than the speed of approach. It is exact where a
distance is linear in the joints; where it bends, the clearance takes up the difference. The bounds
of single joints are in `feasigrasp.models.control.safety.velocity_limits`; how a speed limit is
approached (`SafetyOptions.speed_gain`) bounds only what speeds up.

If the rows cannot be kept, because the arm was pushed or begins too close, it stops: the velocity
between the joints' bounds that breaks them least, and otherwise is nearest to zero. So commands are
finite and continuous whatever comes in. The solver is DAQP (Arnstrom et al., "A dual active-set
solver for embedded quadratic programming using recursive LDL' updates", TAC 2022).
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Self

import daqp
import numpy as np
from numpy.typing import NDArray

from feasigrasp.errors import ControlError
from feasigrasp.models.arguments import check_fields, checked
from feasigrasp.models.arrays import Array, Frozen, record
from feasigrasp.models.control.safety.problem import (
    Body,
    Obstacles,
    Request,
    clip_kernel,
    problem_kernel,
)
from feasigrasp.models.geometry.obstacle_grid import NO_GRID, MovingObject, ObstacleGrid
from feasigrasp.models.quantities import (
    JACOBIAN,
    JOINT_POSITIONS,
    JOINT_RATES,
    TWIST,
    NotNegative,
    Positive,
    PositiveShare,
)
from feasigrasp.models.robot.arm import Arm, Family
from feasigrasp.models.robot.capsules import arm_balls, capsule_model, hand_points
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.robot.iiwa import IIWA_7

#: DAQP's flag of a constraint that may be violated with a penalty. Source: definition: DAQP.
SOFT = 8
#: No velocity, rows and object. Source: layout.
_NONE, _NO_ROWS = np.empty(0), np.empty((0, 0))
_NO_OBJECT = MovingObject(NO_GRID, np.eye(4), np.zeros(6))


@dataclass(frozen=True)
class SafetyOptions:
    """Limits and clearances of the safety filter.

    Attributes:
        period: Time between commands, that of the drive [s].
        position_margin: Distance kept from the joint position limits [rad].
        speed: The arm's speed, a share of its velocity limits, in (0, 1].
        velocity_scale: Share of that which may be used.
        acceleration_scale: Share of the acceleration limits that may be used.
        clearance: Distance kept between bodies [m].
        obstacle_clearance: Distance kept to the obstacles of a scene, whose surfaces are known to a
            centimetre (voxels, noise, edges), and between the arm and the object [m].
        object_clearance: Distance kept between the open hand and the object that it follows [m].
        table_clearance: Distance kept to the table [m].
        table_height: Height of the table top in the base frame [m].
        approach_gain: g; limits and bodies are approached at most at g x remaining distance [1/s].
        speed_gain: g_v; a joint accelerates at most at g_v x what is left to its speed limit [1/s]:
            the arm's own controller overshoots a command whose acceleration ends at once.
        object_gain: As ``approach_gain``, for the open hand and the object it follows [1/s] ...
        slow: ... up to g x distance and this speed [m/s]: a quick hand takes longer to stop.
        rotation_weight: Weight of rad/s against m/s in following a twist.
        damping: rho, the weight of the preferred joint velocity.
        arm: The arm.
    """

    period: Positive = 0.005
    position_margin: NotNegative = IIWA_7.position_margin
    speed: PositiveShare = 1.0
    velocity_scale: PositiveShare = 0.9
    acceleration_scale: PositiveShare = IIWA_7.acceleration_share
    clearance: NotNegative = 0.01
    obstacle_clearance: NotNegative = 0.02
    object_clearance: NotNegative = 0.002
    table_clearance: NotNegative = 0.01
    table_height: float = 0.0
    approach_gain: Positive = 3.3
    speed_gain: Positive = 10.0
    object_gain: Positive = 6.0
    slow: Positive = 0.1
    rotation_weight: Positive = 0.3
    damping: Positive = 1e-3
    arm: Arm = IIWA_7

    @classmethod
    @checked(ControlError)
    def of(cls, arm: Arm) -> Self:
        """The defaults for an arm, approaching no quicker than it can stop."""
        scale, margin = arm.acceleration_share, arm.position_margin
        gain = min(cls.approach_gain, arm.braking_rate(cls.speed * cls.velocity_scale, scale))
        return cls(arm=arm, acceleration_scale=scale, position_margin=margin, approach_gain=gain)

    def __post_init__(self) -> None:
        """Raises ControlError for a wrong number, or a gain that asks for too quick a stop."""
        check_fields(self, ControlError)
        most = self.arm.braking_rate(self.speed * self.velocity_scale, self.acceleration_scale)
        if self.approach_gain > most:
            raise ControlError(
                f"SafetyOptions.approach_gain = {self.approach_gain}: a joint at full speed could "
                f"not stop in time; give at most {most:.3g} (acceleration over velocity limit), or "
                "a smaller speed or velocity_scale"
            )


@dataclass(frozen=True, eq=False)
class SafetyFilter(Frozen):
    """The safety QP of an arm with a hand.

    Attributes:
        options: Margins and gains.
        gripper: The hand, whose capsules the arm carries; the default one if None.
    """

    options: SafetyOptions = field(default_factory=SafetyOptions)
    gripper: Gripper | None = None
    _arrays: tuple[Any, ...] = field(init=False, repr=False)
    _senses: tuple[NDArray[np.intc], NDArray[np.intc]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Lays out the geometry for the kernels, and compiles them."""
        check_fields(self, ControlError)
        arm = self.options.arm
        model, n = capsule_model(self.gripper, arm), arm.joints
        balls, guarded = arm_balls(model), _kept_off_an_object(self.gripper, arm)
        own = arm.chain, model.link, model.ends, model.radius, model.pairs, model.movers
        made: Any = map(np.ascontiguousarray, (*own, *balls[1:], guarded))
        object.__setattr__(self, "_arrays", (record(self.options), Body(*made)))
        most = n + 1 + len(model.pairs) + 2 * len(model.movers) + len(balls.link) + len(guarded)
        hard, soft = np.zeros(most, dtype=np.intc), np.full(most, SOFT, dtype=np.intc)
        soft[:n] = 0
        object.__setattr__(self, "_senses", (hard, soft))
        middle = 0.5 * (arm.lower + arm.upper)
        self.velocity(middle, np.zeros(n), np.zeros((6, n)), np.zeros(6))

    def velocity(
        self,
        q: Array,
        qd_preferred: Array,
        J: Array | None = None,
        V: Array | None = None,
        *,
        qd_last: Array | None = None,
        obstacles: ObstacleGrid | None = None,
        moving: MovingObject | None = None,
    ) -> Array:
        """The admissible joint velocity closest to what is asked for.

        Args:
            q: Joint positions [rad], shape (7,).
            qd_preferred: Preferred joint velocity [rad/s], shape (7,). With ``J`` it only fills the
                redundant directions; without, it is the request itself.
            J: Jacobian of the hand, shape (6, 7), rows [angular; linear].
            V: Desired twist of the hand [rad/s; m/s], shape (6,).
            qd_last: The command of one period ago [rad/s], shape (7,); without it accelerations are
                not limited.
            obstacles: What the arm must not touch, in the frame of its base.
            moving: What arm and open hand should not push. These rows come after all others: they
                are broken as little as possible where not all can be kept.

        Returns:
            Joint velocity [rad/s], shape (7,), always finite. A request that is not finite counts
            as one to stop; if the state is not finite, all joints brake as hard as they may.

        Raises:
            ControlError: An argument of another type or shape, J without V or V without J, or a
                joint that is more than 2.5 turns from zero (degrees?).
        """
        matrix, vector, n_hard = self.problem(
            q, qd_preferred, J, V, qd_last=qd_last, obstacles=obstacles, moving=moving
        )
        if len(matrix) == 0:
            return self._braking(qd_last)
        (hard, soft), joints = self._senses, matrix.shape[1]
        H, rows, (lower, upper, f) = matrix[:joints], matrix[joints:], vector
        n = len(lower)
        senses = hard[:n]
        if n_hard < len(rows):
            senses = np.concatenate([hard[: joints + n_hard], soft[joints + n_hard : n]])
        qd, _, status, _ = daqp.solve(H, f[:joints], rows, upper, lower, senses)
        if status > 0 and clip_kernel(qd, vector):
            return qd
        nearest = np.eye(joints), np.zeros(joints)
        qd, _, status, _ = daqp.solve(*nearest, rows, upper, lower, soft[:n])
        if status > 0 and clip_kernel(qd, vector):
            return qd
        return np.clip(0.0, lower[:joints], upper[:joints])

    def _braking(self, qd_last: Array | None) -> Array:
        """The next velocity (n,) of braking from the last one; zero where that is not finite."""
        arm, last = self.options.arm, np.zeros(self.options.arm.joints)
        if qd_last is not None:
            last = np.where(np.isfinite(qd_last), qd_last, 0.0)
        change = self.options.acceleration_scale * arm.acceleration_limits * self.options.period
        return last - np.clip(last, -change, change)

    @checked(ControlError, "SafetyFilter")
    def problem(
        self,
        q: Annotated[Array, JOINT_POSITIONS],
        qd_preferred: Annotated[Array, JOINT_RATES],
        J: Annotated[Array, JACOBIAN] | None = None,
        V: Annotated[Array, TWIST] | None = None,
        *,
        qd_last: Annotated[Array, JOINT_RATES] | None = None,
        obstacles: ObstacleGrid | None = None,
        moving: MovingObject | None = None,
    ) -> tuple[Array, Array, int]:
        """The QP that `velocity` solves, for its arguments; errors as there.

        Returns:
            ``matrix`` (n + m, n), H above the rows A; and ``vector`` (3, n + m): lower bounds of qd
            and of A qd, their upper bounds, and f followed by zeros; and the number of hard rows.
            The matrix is empty if the state is not finite. Rows that no velocity inside the bounds
            breaks are left out.
        """
        if (J is None) != (V is None):
            raise ControlError("SafetyFilter: J and V belong together; give both or neither")
        most, n = len(self._senses[0]), self.options.arm.joints
        self.options.arm.positions(q, 1)
        matrix, vector = np.empty((most, n)), np.zeros((3, most))
        grid, target = obstacles or NO_GRID, moving or _NO_OBJECT
        srs = self.options.arm.family == Family.SRS
        request = Request(
            q,
            bending_velocity(q, qd_preferred, V) if srs else qd_preferred,
            _NO_ROWS if J is None else J,
            _NONE if V is None else V,
            _NONE if qd_last is None else qd_last,
        )
        moving_grid, pose = target.grid, (target.X_WO, target.V_WO, float(target.extra_clearance))
        scene = Obstacles(grid.values, grid.frame, moving_grid.values, moving_grid.frame, *pose)
        n_hard, m = problem_kernel(request, *self._arrays, scene, matrix, vector)
        return matrix[: n + m if m >= 0 else 0], vector[:, : n + max(m, 0)], n_hard


def _kept_off_an_object(gripper: Gripper | None, arm: Arm) -> Array:
    """Points of the opened hand and balls that cover the arm: link, x, y, z, radius, shape (k, 5).

    The hand is more than its balls, which would fill the room between the fingers.
    """
    points = hand_points(gripper, arm)
    balls = arm_balls(capsule_model(gripper, arm, with_hand=False))
    link = np.full((len(points), 1), float(arm.joints))
    hand = np.hstack([link, points, np.zeros((len(points), 1))])
    return np.concatenate([hand, np.column_stack([balls.link, balls.center, balls.radius])])


def bending_velocity(q: Array, qd_preferred: Array, V: Array | None) -> Array:
    """The preferred velocity; that which bends a straight S-R-S arm's elbow to draw back.

    In that singularity no joint velocity draws the hand towards the shoulder to first order, so
    that the QP would stand still. Redundant joints bend the elbow without moving the hand.
    """
    elbow, straight, rate = 3, np.deg2rad(0.5), 0.1  # [rad], [rad/s]; guessed
    if V is None or not np.abs(q[elbow]) < straight:
        return qd_preferred
    out = np.array([np.cos(q[0]) * np.sin(q[1]), np.sin(q[0]) * np.sin(q[1]), np.cos(q[1])])
    if not V[3:] @ out < -0.5 * np.linalg.norm(V[3:]):
        return qd_preferred
    bent = np.array(qd_preferred, dtype=float)
    bent[elbow] = rate if q[elbow] > 0.0 else -rate
    return bent
