"""Reference configuration and velocity of the selected candidate, at the control rate.

A candidate is a grasp and an inverse-kinematics branch, see
`feasigrasp.models.control.task.choice`; between two plans it is continued in closed form, at the
arm angle that the plan asks for. An arm that is near has an arm angle of its own, which changes to
that one smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.compiled import compiled
from feasigrasp.models.ik.continuation import (
    branch_kernel,
    candidate_velocity_kernel,
    stand_behind_kernel,
)
from feasigrasp.models.control.task.choice import ChoiceOptions, GraspChoice
from feasigrasp.models.control.task.target import target_kernel
from feasigrasp.models.geometry.se3_kernels import inverse_kernel
from feasigrasp.models.grasps.approach_corridor import standoff_kernel
from feasigrasp.models.ik.self_motion import (
    arm_angle_kernel,
    inside_limits_kernel,
    travel_time_kernel,
)
from feasigrasp.models.reach.reachability import Reachability
from feasigrasp.models.robot.iiwa import IIWA_7
from feasigrasp.models.robot.kinematics import pose_jacobian_kernel

#: The arm angle changes no faster than this [rad/s], and in no less time than this [s]. Source:
#: guessed.
_ARM_ANGLE_SPEED, _SHORTEST = 0.8, 0.6
#: A velocity beyond this multiple of the joints' limits is not followed. Source: guessed.
_TOO_FAST = 3.0
#: If the arm angle of the plan is farther away than this, the arm goes there at once [s]. Source:
#: guessed.
_FAR = 0.4


@dataclass(frozen=True, eq=False)
class CandidateReference:
    """Reference configuration and velocity of a candidate.

    Attributes:
        q: Configuration, on the way into the grasp [rad], shape (7,).
        qd: Its velocity as the object moves and the arm angle changes [rad/s], shape (7,).
        X_OT: Pose of the hand in it, in the object frame, shape (4, 4) [m].
        on_candidate: Whether the arm is in the candidate's branch.
    """

    q: Array
    qd: Array
    X_OT: Array
    on_candidate: bool


def candidate_reference(
    choice: GraspChoice,
    t: float,
    q: Array,
    X_WO: Array,
    V_WO: Array,
    reachability: Reachability,
    options: ChoiceOptions,
    *,
    interception: tuple[Array, Array] | None = None,
) -> CandidateReference | None:
    """Configuration and velocity that follow the choice, at the control rate (10 us).

    The hand is led to its target, far away the middle of the grasps round the chosen one and at
    last the grasp itself (`target_kernel`), through the approach corridor; it stays back less where
    a joint limit does not allow more.

    Args:
        choice: What was chosen.
        t: Time [s].
        q: Joint positions [rad], shape (7,).
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Its gripper gives the pose of the flange.
        options: The approach corridor.
        interception: Pose and twist of the object at the interception time: what is asked for is
            where that will be then, as far behind the grasp as the hand has to be now.

    Returns:
        The reference; None without a choice, if the object is out of reach, or if its pose or twist
        is not finite.
    """
    if not choice:
        return None
    X_WO_then, V_WO_then = (X_WO, V_WO) if interception is None else interception
    q_ref, qd_ref, X_OT = np.empty(IIWA_7.joints), np.empty(IIWA_7.joints), np.empty((4, 4))
    status = _reference_kernel(
        np.ascontiguousarray(q, dtype=float),
        np.ascontiguousarray(X_WO, dtype=float),
        np.ascontiguousarray(X_WO_then, dtype=float),
        np.ascontiguousarray(V_WO_then, dtype=float),
        interception is not None,
        choice.X_OG,
        choice.steps,
        choice.weights,
        choice.branch,
        choice.psi,
        choice.interception_time - t,
        reachability.gripper.X_FG,
        reachability.search.limit_margin,
        options.corridor.parameters,
        q_ref,
        qd_ref,
        X_OT,
    )
    return None if status < 0 else CandidateReference(q_ref, qd_ref, X_OT, status == 1)


@compiled
def _continue(
    X_OG, X_OH, X_WO, X_GF, q, branch, psi, remaining, on_candidate, margin, corridor, X_WF, q_ref
):
    """Writes flange pose and configuration on the way into a grasp, at the arm angle to have now.

    Returns how far it is back [m], whether it is in reach, that arm angle [rad] and its rate.
    """
    standoff = standoff_kernel(X_OG, X_OH, corridor)
    back, reached = stand_behind_kernel(
        X_OG, standoff, X_WO, X_GF, branch, psi, margin, X_WF, q_ref
    )
    if not on_candidate:
        return back, reached, psi, 0.0
    if reached and inside_limits_kernel(q_ref, margin) and travel_time_kernel(q, q_ref) > _FAR:
        return back, reached, psi, 0.0
    angle = arm_angle_kernel(q)
    change = (psi - angle + np.pi) % (2.0 * np.pi) - np.pi
    rate = min(max(change / max(remaining, _SHORTEST), -_ARM_ANGLE_SPEED), _ARM_ANGLE_SPEED)
    back, reached = stand_behind_kernel(
        X_OG, standoff, X_WO, X_GF, branch, angle, margin, X_WF, q_ref
    )
    return back, reached, angle, rate


@compiled
def _reference_kernel(
    q,
    X_WO_now,
    X_WO,
    V_WO,
    later,
    chosen,
    steps,
    weights,
    branch,
    psi,
    remaining,
    X_FG,
    margin,
    corridor,
    q_ref,
    qd_ref,
    X_OT,
):
    """Writes what `candidate_reference` returns: 1 on the candidate, 0 on the way, -1 if none."""
    if not np.isfinite(X_WO_now.sum() + X_WO.sum() + V_WO.sum() + q.sum()):
        return -1
    X_WH, X_WF = np.empty((4, 4)), np.empty((4, 4))
    pose_jacobian_kernel(q, X_FG, X_WH, None)
    X_OH = inverse_kernel(X_WO_now) @ X_WH
    X_GF = inverse_kernel(X_FG)
    on_candidate = branch_kernel(q) == branch and not later
    X_OG = target_kernel(chosen, steps, weights, X_OH)
    back, reached, angle, rate = _continue(
        *(X_OG, X_OH, X_WO, X_GF, q, branch, psi, remaining, on_candidate),
        *(margin, corridor, X_WF, q_ref),
    )
    if not reached:  # between grasps in reach there may be a pose that is not
        X_OG = chosen
        back, reached, angle, rate = _continue(
            *(X_OG, X_OH, X_WO, X_GF, q, branch, psi, remaining, on_candidate),
            *(margin, corridor, X_WF, q_ref),
        )
    if not reached:
        return -1
    X_OT[:] = X_OG
    for i in range(3):
        X_OT[i, 3] -= back * X_OG[i, 2]
    fastest = np.inf
    if candidate_velocity_kernel(
        X_WF, V_WO, X_WO[:3, 3], branch, angle, rate, q_ref, np.eye(4), qd_ref
    ):
        fastest = np.max(np.abs(qd_ref) / IIWA_7.velocity_limits)
    # Next to a singularity, or where an angle wraps, there is no velocity to follow.
    for i in range(IIWA_7.joints):
        qd_ref[i] = 0.0 if fastest > _TOO_FAST else qd_ref[i] / max(1.0, fastest)
    return 1 if on_candidate else 0
