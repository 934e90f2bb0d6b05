"""Joint-space control over inverse kinematics solutions of many grasps (paper section IV-D.2).

The arm descends the distance field over the solutions, ``qd = -k d grad d``, while the solutions
move with the object. Added to the paper's law: each solution's own velocity is fed forward, so that
the arm does not lag; the solutions follow the funnel into their grasps; and a QP keeps limits and
clearances, which the field alone does not.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from feasigrasp.models import se3
from feasigrasp.models.damped_least_squares import (
    damped_least_squares_kernel,
    damped_velocity_kernel,
)
from feasigrasp.models.grasp_funnel import Funnel, funnel_targets
from feasigrasp.models.grasps import GraspSet
from feasigrasp.models.iiwa import VELOCITY_LIMITS
from feasigrasp.models.iiwa_kinematics import forward_kinematics, pose_jacobian_kernel
from feasigrasp.models.joint_field import fit_joint_field
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.safe_velocity import SafetyOptions, safe_velocity

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class JointControlOptions:
    """Gains of the joint-space controller.

    Attributes:
        gain: k, rate at which the distance decreases [1/s].
        max_speed: Largest share of the velocity limits used for it.
        n_solutions: Solutions that the field is fitted to.
        refinement_steps: Damped least-squares steps per solution and control tick.
        damping: Their damping.
        max_position_error: A solution that ends farther from its target is left out [m].
        funnel: The way into a grasp.
        safety: Margins of the QP.
    """

    gain: float = 5.0
    max_speed: float = 0.5
    n_solutions: int = 30
    refinement_steps: int = 2
    damping: float = 0.02
    max_position_error: float = 0.02
    funnel: Funnel = field(default_factory=Funnel)
    safety: SafetyOptions = field(default_factory=SafetyOptions)


@dataclass(frozen=True, eq=False)
class Solutions:
    """Grasps with one configuration each: the seeds that the controller continues.

    Attributes:
        X_OG: Grasps in the object frame, shape (n, 4, 4) [m].
        q: Configurations that reach their funnel targets when found, shape (n, 7) [rad].
    """

    X_OG: FloatArray
    q: FloatArray

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("X_OG", "q"):
            array = np.array(getattr(self, name), dtype=float)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __deepcopy__(self, memo: dict[int, Any]) -> Solutions:
        """Immutable, so a copy is itself."""
        return self

    @classmethod
    def empty(cls) -> Solutions:
        """No grasp can be reached."""
        return cls(np.zeros((0, 4, 4)), np.zeros((0, 7)))


def find_solutions(
    grasps: GraspSet,
    X_WO: FloatArray,
    q: FloatArray,
    reachability: Reachability,
    options: JointControlOptions,
) -> Solutions:
    """The configurations, one per grasp, that are soonest reached from ``q``.

    Args:
        grasps: Grasps in the object frame.
        X_WO: Object pose, shape (4, 4).
        q: Joint positions [rad], shape (7,).
        reachability: Finds configurations inside limits and free of collision.
        options: How many are kept.
    """
    if len(grasps) == 0:
        return Solutions.empty()
    X_OH = se3.inverse(X_WO) @ forward_kinematics(q, reachability.gripper.X_FG)
    targets = X_WO @ funnel_targets(grasps.X_OG, X_OH, options.funnel)
    found, travel_time = reachability.nearest(targets, q)
    order = np.argsort(travel_time, kind="stable")[: options.n_solutions]
    order = order[np.isfinite(travel_time[order])]
    return Solutions(grasps.X_OG[order], found[order])


@nb.njit(cache=True)
def _continue_kernel(  # type: ignore[no-untyped-def]
    X_WF, V_WF, steps, damping, q, qd, position_errors
):
    """Refines configurations in place and writes the joint velocities of the moving targets."""
    identity, X, J = np.eye(4), np.empty((4, 4)), np.empty((6, 7))
    A, y = np.empty((6, 6)), np.empty(6)
    for k in range(len(q)):
        position_errors[k], _ = damped_least_squares_kernel(X_WF[k], q[k], steps, damping)
        pose_jacobian_kernel(q[k], identity, X, J)
        damped_velocity_kernel(J, V_WF[k], damping, A, y, qd[k])


def joint_space_velocity(
    q: FloatArray,
    solutions: Solutions,
    X_WO: FloatArray,
    V_WO: FloatArray,
    reachability: Reachability,
    options: JointControlOptions,
    *,
    enforce_limits: bool = True,
) -> FloatArray:
    """Joint velocity of the joint-space controller.

    Args:
        q: Joint positions [rad], shape (7,).
        solutions: Seeds found a moment ago.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Its gripper tells where the hand is on the flange.
        options: Gains.
        enforce_limits: Whether the QP keeps limits and clearances; the paper enforces nothing.

    Returns:
        Joint velocity [rad/s], shape (7,); zero if there is no solution, or if the object's pose
        or twist is not finite.
    """
    known = np.isfinite(X_WO).all() and np.isfinite(V_WO).all()
    if len(solutions.q) == 0 or not known:
        return safe_velocity(q, np.zeros(7), options=options.safety)
    X_FG = reachability.gripper.X_FG
    X_OH = se3.inverse_kernel(X_WO) @ forward_kinematics(q, X_FG)
    targets = funnel_targets(solutions.X_OG, X_OH, options.funnel)
    X_WF = X_WO @ targets @ se3.inverse_kernel(X_FG)
    V_WF = np.empty((len(X_WF), 6))
    V_WF[:, :3] = V_WO[:3]
    V_WF[:, 3:] = V_WO[3:] + (X_WF[:, :3, 3] - X_WO[:3, 3]) @ se3.hat_kernel(V_WO[:3]).T
    q_i, qd_i, errors = solutions.q.copy(), np.empty_like(solutions.q), np.empty(len(X_WF))
    _continue_kernel(X_WF, V_WF, options.refinement_steps, options.damping, q_i, qd_i, errors)
    good = errors < options.max_position_error
    if not good.any():
        return safe_velocity(q, np.zeros(7), options=options.safety)

    d, gradient, weights = fit_joint_field(q_i[good]).evaluate(q)
    length = float(np.linalg.norm(gradient))
    descent = -options.gain * max(d, 0.0) * gradient / max(length, 1e-9)
    excess = float(np.max(np.abs(descent) / (options.max_speed * VELOCITY_LIMITS)))
    qd = descent / max(1.0, excess) + weights @ qd_i[good]
    return safe_velocity(q, qd, options=options.safety) if enforce_limits else qd
