"""Alternative laws from a hand twist to a safe joint velocity.

Each law takes a `State` and returns the next joint velocity, or None if it has found none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.inverse_kinematics import (
    DifferentialInverseKinematicsParameters,
    DifferentialInverseKinematicsStatus,
    DifferentialInverseKinematicsSystem,
    DoDifferentialInverseKinematics,
)
from pydrake.multibody.math import SpatialVelocity
from pydrake.planning import DofMask, JointLimits
from pydrake.systems.framework import BusValue

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.control.safety.safe_velocity import SafetyFilter, SafetyOptions
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp_lab.peers.drake_arm import DrakeArm

_N = IIWA_7.joints


@dataclass(frozen=True, eq=False)
class State:
    """One control tick.

    Attributes:
        q: Joint positions, shape (7,) [rad].
        qd_last: Previous command, shape (7,) [rad/s].
        J: Jacobian of the hand, rows [angular; linear], shape (6, 7).
        V: Desired twist, shape (6,) [rad/s; m/s].
        qd_preferred: What the redundant motion should be, shape (7,) [rad/s].
        lower: Bounds of the QP on qd and on ``rows @ qd``, shape (7 + m,).
        upper: The same from above.
        rows: Shape (m, 7).
    """

    q: Array
    qd_last: Array
    J: Array
    V: Array
    qd_preferred: Array
    lower: Array
    upper: Array
    rows: Array


Law = Callable[[State], "Array | None"]


def package(safety: SafetyFilter) -> Law:
    """The package's own QP, its matrices included."""
    return lambda s: safety.velocity(s.q, s.qd_preferred, s.J, s.V, qd_last=s.qd_last)


def clamped_pseudo_inverse(damping: float = 0.05) -> Law:
    """The damped pseudo-inverse, each joint clipped to its bounds afterwards."""

    def law(s: State) -> Array:
        inverse = s.J.T @ np.linalg.inv(s.J @ s.J.T + damping**2 * np.eye(6))
        qd = s.qd_preferred + inverse @ (s.V - s.J @ s.qd_preferred)
        return np.clip(qd, s.lower[:_N], s.upper[:_N])

    return law


@compiled
def _saturate(J, V, qd_preferred, lower, upper):
    """Saturation in the null space (Flacco, De Luca, Khatib, ICRA 2012, algorithm 1)."""
    free, fixed = np.ones(_N), qd_preferred.copy()
    best_scale, best = -1.0, np.minimum(np.maximum(np.zeros(_N), lower), upper)
    for _ in range(8):
        inverse = np.diag(free) @ np.linalg.pinv(J * free, 1e-3)
        along, rest = inverse @ V, fixed - inverse @ (J @ fixed)
        # The largest share of the twist that the free joints can do inside their bounds.
        low, high, critical = 0.0, 1.0, -1
        for i in range(_N):
            if free[i] == 0.0:
                continue
            a, b = along[i], rest[i]
            if abs(a) < 1e-9:
                if b < lower[i] - 1e-9 or b > upper[i] + 1e-9:
                    high = -1.0
                continue
            first, second = (lower[i] - b) / a, (upper[i] - b) / a
            low = max(low, min(first, second))
            if max(first, second) < high:
                high, critical = max(first, second), i
        if low <= high and high > best_scale:
            best_scale = high
            best = np.minimum(np.maximum(high * along + rest, lower), upper)
        qd = along + rest
        if high >= 1.0 and low <= high:
            return best
        if critical < 0 or low > high:  # the one that is farthest outside
            excess = np.maximum(qd - upper, lower - qd) * free
            critical = int(np.argmax(excess))
        fixed[critical] = min(max(qd[critical], lower[critical]), upper[critical])
        free[critical] = 0.0
        if free.sum() < 1.0:
            return best
    return best


def saturation_in_the_null_space(s: State) -> Array:
    """Pseudo-inverse, joints at their bounds taken out one by one; no clearance."""
    return np.asarray(_saturate(s.J, s.V, s.qd_preferred, s.lower[:_N], s.upper[:_N]))


def drake_function(options: SafetyOptions) -> Law:
    """Drake's ``DoDifferentialInverseKinematics`` with our limits.

    It keeps the direction of the twist and scales it down. From Python it takes no rows, a
    position limit holds for the next step only, and a speed limit may be reached in a hurry.
    """
    parameters = DifferentialInverseKinematicsParameters(_N, _N)
    parameters.set_time_step(options.period)
    parameters.set_joint_centering_gain(np.eye(_N))
    position = IIWA_7.position_limits - options.position_margin
    velocity = options.velocity_scale * IIWA_7.velocity_limits
    acceleration = options.acceleration_scale * IIWA_7.acceleration_limits
    parameters.set_joint_position_limits((-position, position))
    parameters.set_joint_velocity_limits((-velocity, velocity))
    parameters.set_joint_acceleration_limits((-acceleration, acceleration))
    found = DifferentialInverseKinematicsStatus.kSolutionFound
    stuck = DifferentialInverseKinematicsStatus.kStuck

    def law(s: State) -> Array | None:
        parameters.set_nominal_joint_position(s.q + s.qd_preferred)
        result = DoDifferentialInverseKinematics(s.q, s.qd_last, s.V, s.J, parameters)
        return np.asarray(result.joint_velocities) if result.status in (found, stuck) else None

    return law


def drake_system(options: SafetyOptions) -> Law:
    """Drake's `DifferentialInverseKinematicsSystem`: its own kinematics, clearances and limits.

    It has no acceleration limits and no preferred velocity but towards a posture; clearances are
    to hold after the next step, so that an approach is not slowed down before.
    """
    IK = DifferentialInverseKinematicsSystem
    Cost, Centering = IK.LeastSquaresCost, IK.JointCenteringCost
    Velocity, Collision = IK.JointVelocityLimitConstraint, IK.CollisionConstraint
    position = IIWA_7.position_limits - options.position_margin
    velocity = options.velocity_scale * IIWA_7.velocity_limits
    free = np.full(_N, np.inf)
    limits = JointLimits(-position, position, -velocity, velocity, -free, free)
    slowed = Velocity.Config(min_margin=0.0, influence_margin=0.2)
    clear = Collision.Config(safety_distance=options.clearance, influence_distance=0.08)
    recipe = IK.Recipe()
    recipe.AddIngredient(Cost(config=Cost.Config(cartesian_qp_weight=100.0)))
    recipe.AddIngredient(Centering(config=Centering.Config(posture_gain=1.0)))
    recipe.AddIngredient(Velocity(config=slowed, joint_limits=limits))
    recipe.AddIngredient(Collision(config=clear))
    system = IK(
        recipe=recipe,
        task_frame="world",
        collision_checker=DrakeArm(table=True).checker,
        active_dof=DofMask(_N, True),
        time_step=options.period,
        K_VX=1.0,
        Vd_TG_limit=SpatialVelocity(np.full(3, 100.0), np.full(3, 100.0)),
    )
    context = system.CreateDefaultContext()
    position_port, posture_port, twist_port, output = (
        system.GetInputPort("position"),
        system.GetInputPort("nominal_posture"),
        system.GetInputPort("desired_cartesian_velocities"),
        system.GetOutputPort("commanded_velocity"),
    )

    def law(s: State) -> Array | None:
        twist = BusValue()
        twist.Set("iiwa7::iiwa_flange", Value(SpatialVelocity(s.V)))
        position_port.FixValue(context, s.q)
        posture_port.FixValue(context, s.q + s.qd_preferred)
        twist_port.FixValue(context, Value(twist))
        try:
            return np.array(output.Eval(context))
        except RuntimeError:  # it found no solution
            return None

    return law
