"""Task-space control over a Riemannian mixture of grasps (paper section IV-D.1).

The hand follows the gradient of the mixture's log-density, preconditioned so that every component
is approached along its geodesic, while it is carried along with the object's twist. Three things
are added to the paper's law, because without them the arm ends at its limits or lags behind:

- the object's twist is fed forward;
- a component counts by how soon the arm can be there, ``exp(-travel time / tau)``, with the travel
  time of the nearest exact inverse-kinematics solution; components out of reach count nothing;
- the redundant joint motion leads to that solution, and a QP keeps limits and clearances.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numba as nb
import numpy as np
from numpy.typing import NDArray

from feasigrasp.models import se3
from feasigrasp.models.grasp_funnel import Funnel, steering_kernel
from feasigrasp.models.grasp_mixture import GraspMixture, closest_members_kernel
from feasigrasp.models.iiwa_kinematics import pose_and_jacobian, pose_jacobian_kernel
from feasigrasp.models.reachability import Reachability
from feasigrasp.models.reachability_kernels import make_room, nearest_kernel
from feasigrasp.models.riemannian_kernels import evaluate_kernel
from feasigrasp.models.safe_velocity import SafetyOptions, safe_velocity
from feasigrasp.models.se3_kernels import inverse_kernel

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class TaskControlOptions:
    """Gains of the task-space controller.

    Attributes:
        gain: Rate at which the hand closes its distance to the grasps [1/s].
        max_linear: Largest speed relative to the object [m/s].
        max_angular: Largest angular speed relative to the object [rad/s].
        travel_time_scale: tau, the travel time that costs a component a factor e [s].
        posture_gain: Rate at which redundant motion leads to the nearest solution [1/s].
        funnel: The way into a grasp.
        safety: Margins of the QP.
    """

    gain: float = 5.0
    max_linear: float = 0.4
    max_angular: float = 1.5
    travel_time_scale: float = 0.05
    posture_gain: float = 1.0
    funnel: Funnel = field(default_factory=Funnel)
    safety: SafetyOptions = field(default_factory=SafetyOptions)

    @property
    def gains(self) -> tuple[float, float, float, float, float]:
        """The numbers that the kernel takes."""
        return (
            self.gain,
            self.max_angular,
            self.max_linear,
            self.travel_time_scale,
            self.posture_gain,
        )


@nb.njit(cache=True)
def hand_twist_kernel(u_H, X_WH, X_WO, V_WO, max_angular, max_linear):  # type: ignore[no-untyped-def]
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


@nb.njit(cache=True)
def selection_kernel(log_density, travel_time, travel_time_scale):  # type: ignore[no-untyped-def]
    """How much each component counts, summing to 1.

    Far from all grasps the plain density is all but zero: tempered by the distance of the nearest
    component it stays comparable, and the travel times decide.
    """
    log_weight = log_density / max(1.0, -np.max(log_density)) - travel_time / travel_time_scale
    weight = np.exp(log_weight - np.max(log_weight))
    return weight / np.sum(weight)


@nb.njit(cache=True)
def _steer_kernel(  # type: ignore[no-untyped-def]
    q, X_FG, X_WO, V_WO, X_OG, component, parameters, search, funnel, gains, J_WH, posture
):
    """Writes the hand's Jacobian (6, 7) and the posture velocity (7,); returns the hand's twist.

    One kernel, since it runs at the control rate between steps of the physics, with cold caches.
    The twist is empty if no component can be reached.
    """
    gain, max_angular, max_linear, travel_time_scale, posture_gain = gains
    X_WH = np.empty((4, 4))
    pose_jacobian_kernel(q, X_FG, X_WH, J_WH)
    X_OH = inverse_kernel(X_WO) @ X_WH
    X_GF = inverse_kernel(X_FG)
    K = len(parameters[0])
    member = np.empty(K, dtype=np.int64)
    closest_members_kernel(X_OG, component, X_OH, member)
    tangents, densities = np.empty((K, 6)), np.empty(K)
    evaluate_kernel(X_OH, parameters, tangents, densities)

    # The members that can be reached, how soon, and in which configuration.
    n = 0
    X_OM, solutions = np.empty((K, 4, 4)), np.empty((K, 7))
    log_density, travel_time = np.empty(K), np.empty(K)
    room = make_room(search, q)
    for k in range(K):
        if member[k] < 0:
            continue
        X_WF = X_WO @ X_OG[member[k]] @ X_GF
        travel_time[n] = nearest_kernel(X_WF, q, search, room, solutions[n])
        if travel_time[n] < np.inf:
            X_OM[n] = X_OG[member[k]]
            log_density[n] = densities[k]
            n += 1
    if n == 0:
        return np.empty(0)
    weight = selection_kernel(log_density[:n], travel_time[:n], travel_time_scale)
    posture[:] = posture_gain * (weight @ (solutions[:n] - q))
    u_H = np.empty(6)
    steering_kernel(X_OM[:n], X_OH, funnel, weight, u_H)
    return hand_twist_kernel(gain * u_H, X_WH, X_WO, V_WO, max_angular, max_linear)


def task_space_velocity(
    q: FloatArray,
    grasps: GraspMixture,
    X_WO: FloatArray,
    V_WO: FloatArray,
    reachability: Reachability,
    options: TaskControlOptions,
) -> FloatArray:
    """Joint velocity of the safe task-space controller.

    Args:
        q: Joint positions [rad], shape (7,).
        grasps: Mixture over the grasps, in the object frame.
        X_WO: Object pose, shape (4, 4).
        V_WO: Object twist [angular; linear], shape (6,).
        reachability: Decides which grasps can be reached, and how soon.
        options: Gains.

    Returns:
        Joint velocity [rad/s], shape (7,); zero if no component can be reached.
    """
    J_WH, posture = np.empty((6, 7)), np.zeros(7)
    V_WH = _steer_kernel(
        np.ascontiguousarray(q, dtype=float),
        reachability.gripper.X_FG,
        np.ascontiguousarray(X_WO, dtype=float),
        np.ascontiguousarray(V_WO, dtype=float),
        grasps.X_OG,
        grasps.component,
        grasps.mixture.parameters,
        reachability.search,
        options.funnel.parameters,
        options.gains,
        J_WH,
        posture,
    )
    if len(V_WH) == 0:
        return safe_velocity(q, posture, options=options.safety)
    return safe_velocity(q, posture, J_WH, V_WH, options.safety)


def paper_task_space_velocity(
    q: FloatArray,
    grasps: GraspMixture,
    X_WO: FloatArray,
    V_WO: FloatArray,
    X_FG: FloatArray,
    options: TaskControlOptions,
) -> FloatArray:
    """The paper's law with its corrections: ``qd = J^+ V``, nothing enforced.

    The twist V is the preconditioned direction of the log-density plus the object's own twist.
    Arguments and result as `task_space_velocity`; ``X_FG`` is the grasp frame on the flange.
    """
    X_WH, J_WH = pose_and_jacobian(q, X_FG)
    X_OH = se3.inverse(X_WO) @ X_WH
    u_H = options.gain * grasps.mixture.direction(X_OH[None])[0]
    V_WH = hand_twist_kernel(u_H, X_WH, X_WO, V_WO, options.max_angular, options.max_linear)
    return np.linalg.pinv(J_WH) @ V_WH if np.isfinite(V_WH).all() else np.zeros(len(q))
